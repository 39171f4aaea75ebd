"""The information term of the paper's public code, to compare Lemma 2 with.

It departs from the paper (Equations 7 and 9 of Yu et al., 2019): q scores a fresh m at the very
demonstration that m was drawn from, not the m that produced a rollout at that rollout. In the mean
of q that has no gradient, in its deviation a constant one (it shrinks); and the number that
multiplies the reward's gradient says nothing about the rollout. Source: ermongroup/MetaIRL,
``inverse_rl/models/info_airl_state_train.py``. For comparisons alone.
"""

from __future__ import annotations

from tensordict import TensorDict, TensorDictBase

from pemirl_trl import PEMIRLModel
from pemirl_trl.methods import PEMIRLConfig
from pemirl_trl.modules.network import device_of


class PublicCodeInfoLoss:
    """What the public code computes, with the keys of :class:`pemirl_trl.InfoLoss`.

    Args:
        model: q, r and f.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``.
        config: gives K, and what the return sums, as for :class:`pemirl_trl.InfoLoss`.
    """

    def __init__(
        self, model: PEMIRLModel, demonstrations: TensorDictBase, config: PEMIRLConfig
    ) -> None:
        self.model, self.config = model, config
        self.demonstrations = demonstrations.to(device_of(model))

    def __call__(self, rollouts: TensorDictBase) -> TensorDictBase:
        """Compute both losses of rollouts ``[N, T]`` with ``demonstration``, context-major."""
        posterior = self.model.encoder.get_dist(
            self.demonstrations[rollouts["demonstration"][:, 0]]
        )
        m = posterior.rsample()  # [N, D], a fresh one for each rollout
        log_q = posterior.log_prob(m)
        inputs = TensorDict(
            {
                "observation": rollouts["observation"],
                ("next", "observation"): rollouts["next", "observation"],
                "context": m.detach().unsqueeze(1).expand(*rollouts.shape, -1),
            },
            rollouts.shape,
        )
        reward = self.model.reward(inputs)
        summand = "shaped_reward" if self.config.info_summand == "shaped" else "learned_reward"
        steps = reward[summand].squeeze(-1)
        returns = steps.mean(-1) if self.config.info_time_mean else steps.sum(-1)
        returns = returns.view(-1, self.config.rollouts_per_context)
        centred = returns - returns.mean(1, keepdim=True)
        loss_reward = -(log_q.detach().view_as(returns) * centred).mean()
        return TensorDict(
            {
                "loss_info_encoder": -log_q.mean(),
                "loss_info_reward": loss_reward,
                "log_q": log_q.detach().mean(),
            }
        )
