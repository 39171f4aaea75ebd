"""Meta-imitation learning with latent contexts: a conditional VAE of demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictParams, dispatch
from tensordict.utils import NestedKey

from pemirl_trl.functional import kl_to_standard_normal
from pemirl_trl.objectives.common import KeyedLoss


class MetaILLoss(KeyedLoss):
    r"""The negative evidence bound of Meta-IL, for psi and omega together.

    ``loss_imitation`` = -mean_t log pi(a_t|s_t, m), m ~ q_psi(m|tau) by reparameterisation, and
    ``loss_kl`` = kl_coeff * KL(q_psi(m|tau) || N(0, I)). (Yu et al., 2019, Section 4; the
    coefficient 0.1 is that of the authors' code.)

    Metrics (detached): ``kl`` in nats.

    Args:
        encoder: q_psi.
        policy: pi_omega.
        kl_coeff: weight of the KL term, per trajectory, against the likelihood per step.
    """

    @dataclass
    class _AcceptedKeys:
        observation: NestedKey = "observation"
        action: NestedKey = "action"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    out_keys = ["loss_imitation", "loss_kl", "kl"]  # noqa: RUF012 (TorchRL's convention)

    encoder_network: ProbabilisticTensorDictSequential
    encoder_network_params: TensorDictParams
    target_encoder_network_params: TensorDictParams
    actor_network: ProbabilisticTensorDictSequential
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init__(
        self,
        encoder: ProbabilisticTensorDictSequential,
        policy: ProbabilisticTensorDictSequential,
        *,
        kl_coeff: float = 0.1,
    ) -> None:
        super().__init__()
        self.convert_to_functional(encoder, "encoder_network", create_target_params=False)
        self.convert_to_functional(policy, "actor_network", create_target_params=False)
        self.kl_coeff = kl_coeff

    def _input_keys(self) -> list[NestedKey]:
        return [self.tensor_keys.observation, self.tensor_keys.action]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute both losses on demonstrations of one length, leaves ``[N, T, ...]``."""
        observation, action = (tensordict[key] for key in self._input_keys())
        inputs = TensorDict({"observation": observation, "action": action}, observation.shape[:1])
        with self.encoder_network_params.to_module(
            self.encoder_network, preserve_module_state=False
        ):
            posterior = self.encoder_network.get_dist(inputs)
        # The loss runs under deterministic exploration: the module itself would give the mean.
        m = posterior.rsample()
        steps = observation.shape[:2]
        context = m.unsqueeze(1).expand(*steps, m.shape[-1])
        log_prob = _log_prob(self, observation, action, context)
        kl = kl_to_standard_normal(posterior.mean, posterior.stddev).mean()
        return TensorDict(
            {
                "loss_imitation": -log_prob.mean(),
                "loss_kl": self.kl_coeff * kl,
                "kl": kl.detach(),
            }
        )


def _log_prob(
    loss: MetaILLoss, observation: torch.Tensor, action: torch.Tensor, context: torch.Tensor
) -> torch.Tensor:
    keys = loss.actor_network.in_keys
    inputs = TensorDict(dict(zip(keys, (observation, context), strict=True)), observation.shape[:2])
    with loss.actor_network_params.to_module(loss.actor_network, preserve_module_state=False):
        return loss.actor_network.get_dist(inputs).log_prob(action)
