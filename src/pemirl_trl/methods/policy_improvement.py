"""The policy's side of every adversarial method: what it maximises, and one step towards it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl.functional import PolicyReward, policy_reward
from pemirl_trl.methods.policy_step import PolicyStep, TRPOConfig
from pemirl_trl.methods.schedule import log_linear
from pemirl_trl.modules import ContextPolicy, ShapedReward


@dataclass(frozen=True)
class PolicyConfig:
    """Of the policy's side of an adversarial method.

    Attributes:
        trpo: of one step.
        imitation_coeff: weight of the demonstrations' log-likelihood per step, in nats; 0 is off.
        final_imitation_coeff: to which that weight grows; None holds it.
        final_scale: to which the policy's deviation shrinks; None leaves it to the policy.
        anneal_from: share of the iterations after which weight and deviation move, log-linearly,
            until the last iteration. The last two are extensions of the paper: the reward is
            learned against an exploring policy, and the policy that is kept acts precisely.
    """

    trpo: TRPOConfig = field(default_factory=TRPOConfig)
    imitation_coeff: float = 0.01
    final_imitation_coeff: float | None = None
    final_scale: float | None = None
    anneal_from: float = 0.5


@torch.no_grad()
def learned_policy_reward(
    reward: ShapedReward, rollouts: TensorDictBase, kind: PolicyReward
) -> Tensor:
    """What the policy maximises of the learned reward, ``[N, T, 1]``; see ``policy_reward``."""
    keys = reward.in_keys
    if kind == "state":  # r needs no next observation; the potentials' time is saved
        keys = [keys[0], keys[2]]
    scored = reward(rollouts.select(*keys))
    state = scored["learned_reward"]
    shaped = scored.get("shaped_reward", state)
    return policy_reward(state, shaped, rollouts["action_log_prob"].unsqueeze(-1), kind)


class PolicyImprovement:
    """One trust-region step on a given reward, the imitation term inside the trust region.

    Imitation is the log-likelihood of each demonstration under pi(a | s, m), with the m that was
    drawn from that demonstration for the rollouts (Yu et al., 2019, Appendix E.1).

    Args:
        policy: moved in place.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``.
        config: of the step.
        rollouts_per_context: K.
    """

    def __init__(
        self,
        policy: ContextPolicy,
        demonstrations: TensorDictBase,
        config: PolicyConfig,
        rollouts_per_context: int,
    ) -> None:
        self.policy, self.demonstrations, self.config = policy, demonstrations, config
        self.rollouts_per_context = rollouts_per_context
        self.imitation_coeff = config.imitation_coeff
        self._initial_scale = float(policy.log_scale.detach().exp().mean())
        if config.final_scale is not None:
            policy.log_scale.requires_grad_(False)
        self._step = PolicyStep(policy, config.trpo, rollouts_per_context)

    def anneal(self, progress: float) -> None:
        """Set deviation and weight for ``progress``, the share of the iterations that is done."""
        c = self.config
        if c.final_scale is not None:
            scale = log_linear(self._initial_scale, c.final_scale, progress, begin=c.anneal_from)
            self.policy.log_scale.data.fill_(math.log(scale))
        if c.final_imitation_coeff is not None:
            self.imitation_coeff = log_linear(
                c.imitation_coeff, c.final_imitation_coeff, progress, begin=c.anneal_from
            )

    def __call__(self, rollouts: TensorDictBase, reward: Tensor) -> dict[str, float]:
        """Improve the policy on ``reward`` ``[N, T, 1]`` of rollouts ``[N, T]``; metrics."""
        batch = rollouts.copy().set(("next", "reward"), reward)
        metrics = self._step(batch, self.imitation_loss(rollouts))
        return {"return/learned": float(reward.sum(1).mean()), **metrics}

    def imitation_loss(self, rollouts: TensorDictBase) -> Callable[[], Tensor] | None:
        """() -> minus the weighted log-likelihood of the rollouts' demonstrations."""
        if self.imitation_coeff == 0:
            return None
        first = rollouts[:: self.rollouts_per_context]  # one row per context
        demonstrations = self.demonstrations[first["demonstration"][:, 0]]
        batch = TensorDict(
            {"observation": demonstrations["observation"], "context": first["context"]},
            first.shape,
        ).reshape(-1)
        action = demonstrations["action"].flatten(0, 1)

        def loss() -> Tensor:
            log_prob = self.policy.get_dist(batch.copy()).log_prob(action)
            return -self.imitation_coeff * log_prob.mean()

        return loss
