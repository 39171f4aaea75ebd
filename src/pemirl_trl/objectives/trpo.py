"""The surrogate and the constraint of trust-region policy optimisation."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictParams, dispatch
from tensordict.utils import NestedKey
from torch.distributions import kl_divergence

from pemirl_trl.functional import surrogate
from pemirl_trl.objectives.common import KeyedLoss


class TRPOLoss(KeyedLoss):
    r"""``loss_objective`` = -mean (pi/pi_old) A - entropy_coeff * H(pi), and its constraint.

    ``kl`` = mean KL(pi_old || pi), differentiable and *not* detached: it is the constraint, for
    :class:`pemirl_trl.TrustRegionOptimizer`. pi_old is rebuilt from the distribution's parameters
    stored at collection, so ``kl`` is exactly zero before the step. Metric (detached): ``entropy``.

    (Schulman et al., 2015, Equation 14.)

    Args:
        policy: a ``ProbabilisticActor`` whose rollouts store its distribution's parameters.
        entropy_coeff: weight of the entropy in nats. Note that advantages are commonly
            standardised, so this is relative to one deviation of the advantage.
        reduction: of the objective; the constraint is always a mean.
    """

    @dataclass
    class _AcceptedKeys:
        action: NestedKey = "action"
        action_log_prob: NestedKey = "action_log_prob"
        advantage: NestedKey = "advantage"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    out_keys = ["loss_objective", "kl", "entropy"]  # noqa: RUF012 (TorchRL's convention)

    actor_network: ProbabilisticTensorDictSequential
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init__(
        self,
        policy: ProbabilisticTensorDictSequential,
        *,
        entropy_coeff: float = 0.0,
        reduction: str = "mean",
    ) -> None:
        super().__init__()
        self.convert_to_functional(policy, "actor_network", create_target_params=False)
        self.entropy_coeff = entropy_coeff
        self.reduction = reduction

    def _input_keys(self) -> list[NestedKey]:
        k = self.tensor_keys
        network = self.actor_network
        # What the policy reads, and what it stored of its distribution at collection.
        parameters = list(network[-1].dist_params_keys)
        return [*network.in_keys, *parameters, k.action, k.action_log_prob, k.advantage]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute the objective and the constraint on any batch size ``[...]``.

        ``advantage`` and ``action_log_prob`` are ``[...]`` or ``[..., 1]``.
        """
        k = self.tensor_keys
        old = self.actor_network.build_dist_from_params(tensordict)
        inputs = tensordict.select(*self.actor_network.in_keys)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            new = self.actor_network.get_dist(inputs)
        log_prob = new.log_prob(tensordict[k.action])
        old_log_prob = tensordict[k.action_log_prob].view_as(log_prob)
        advantage = tensordict[k.advantage].view_as(log_prob)
        entropy = new.entropy()
        gain = surrogate(log_prob, old_log_prob, advantage) + self.entropy_coeff * entropy
        return TensorDict(
            {
                "loss_objective": self._reduce_loss(-gain, tensordict),
                "kl": kl_divergence(old, new).mean(),
                "entropy": entropy.detach().mean(),
            }
        )
