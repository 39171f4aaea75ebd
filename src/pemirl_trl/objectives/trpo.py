"""The surrogate and the constraint of trust-region policy optimisation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictParams, dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torch.distributions import Distribution, kl_divergence
from torchrl.modules import TanhNormal

from pemirl_trl.functional import surrogate
from pemirl_trl.modules.reading import POLICY, read
from pemirl_trl.objectives.common import KeyedLoss


class TRPOLoss(KeyedLoss):
    r"""The surrogate -mean (pi/pi_old) A - entropy_coeff * H(pi), and its constraint.

    ``loss_objective`` is that surrogate, in the advantage's units. ``kl`` = mean KL(pi_old || pi),
    in nats, is differentiable and *not* detached: it is the constraint, for
    :class:`pemirl_trl.TrustRegionOptimizer`. pi_old is rebuilt from the distribution's parameters
    stored at collection, so ``kl`` is exactly zero before the step. All that is stored is data:
    should the batch's log-probabilities or parameters carry gradients, they are detached, since
    pi/pi_old would otherwise be 1 with a gradient of zero. Metric (detached): ``entropy``, in
    nats, where the distribution has one in closed form.

    Source: Schulman, Levine, Moritz, Jordan and Abbeel (2015), "Trust Region Policy Optimization",
    arXiv:1502.05477, Equation 14.

    Args:
        policy: a ``ProbabilisticActor`` whose rollouts store its distribution's parameters, for
            example :class:`pemirl_trl.ContextPolicy` or one with TorchRL's ``TanhNormal``. Its
            ``log_prob_key`` is where log pi_old is read, unless ``set_keys`` says otherwise.
        entropy_coeff: weight of the entropy in nats. Note that advantages are commonly
            standardised, so this is relative to one deviation of the advantage.
        reduction: of the objective; the constraint is always a mean.

    Raises:
        TypeError: no policy was given.
        ValueError: entropy is asked of a distribution that has none in closed form.
        MissingKeyError: on a call, the batch lacks a key.

    Example:
        >>> import torch
        >>> from pemirl_trl import ContextPolicy
        >>> policy = ContextPolicy(observation_dim=6, action_dim=2, context_dim=3)
        >>> states, m = torch.randn(4, 6), torch.randn(4, 3)
        >>> batch = TensorDict({"observation": states, "context": m}, [4])
        >>> with torch.no_grad():
        ...     batch = policy(batch)  # as a collector does
        >>> losses = TRPOLoss(policy)(batch.set("advantage", torch.randn(4, 1)))
        >>> sorted(losses.keys()), losses["kl"].item()
        (['entropy', 'kl', 'loss_objective'], 0.0)
    """

    @dataclass
    class _AcceptedKeys:
        action: NestedKey = "action"
        action_log_prob: NestedKey = "action_log_prob"
        advantage: NestedKey = "advantage"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys

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
        POLICY.required(policy, "TRPOLoss")
        has_entropy = _has_entropy(policy)
        if entropy_coeff != 0 and not has_entropy:
            raise ValueError(
                f"entropy_coeff is {entropy_coeff}, but {_distribution_class(policy).__name__} has "
                "no entropy in closed form; expected 0"
            )
        super().__init__()
        self.convert_to_functional(policy, "actor_network", create_target_params=False)
        self.entropy_coeff = entropy_coeff
        self.reduction = reduction
        self.out_keys = ["loss_objective", "kl", *(["entropy"] if has_entropy else [])]
        self._reports_entropy = has_entropy
        self.set_keys(action_log_prob=policy[-1].log_prob_key)

    @property
    def _parameter_keys(self) -> list[NestedKey]:
        """What the policy stored of its distribution at collection."""
        return list(self.actor_network[-1].dist_params_keys)

    def _input_keys(self) -> list[NestedKey]:
        k = self.tensor_keys
        parameters = self._parameter_keys
        return [*self.actor_network.in_keys, *parameters, k.action, k.action_log_prob, k.advantage]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute the objective and the constraint.

        Args:
            tensordict: any batch size ``[...]``, with what the policy reads, the parameters of its
                distribution and ``action``; ``advantage`` and ``action_log_prob`` are ``[...]`` or
                ``[..., 1]``.

        Raises:
            MissingKeyError: it lacks one of ``in_keys``.
        """
        stored = {key: read(tensordict, key, "TRPOLoss", "loc") for key in self._parameter_keys}
        inputs = {key: read(tensordict, key, "TRPOLoss") for key in self.actor_network.in_keys}
        old_batch = TensorDict(stored, tensordict.batch_size).detach()
        old = self.actor_network.build_dist_from_params(old_batch)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            new = self.actor_network.get_dist(TensorDict(inputs, tensordict.batch_size))
        log_prob = new.log_prob(self._read(tensordict, "action"))
        old_log_prob = self._read(tensordict, "action_log_prob").detach().view_as(log_prob)
        advantage = self._read(tensordict, "advantage").detach().view_as(log_prob)
        gain = surrogate(log_prob, old_log_prob, advantage)
        result = {"kl": _kl(old, new).mean()}
        if self._reports_entropy:
            with torch.set_grad_enabled(torch.is_grad_enabled() and self.entropy_coeff != 0):
                entropy = new.entropy()
            result["entropy"] = entropy.detach().mean()
            if self.entropy_coeff != 0:
                gain = gain + self.entropy_coeff * entropy
        return TensorDict({"loss_objective": self._reduce_loss(-gain, tensordict), **result})


def _distribution_class(policy: ProbabilisticTensorDictSequential) -> Any:
    built = policy[-1].distribution_class
    return built.func if isinstance(built, partial) else built


def _has_entropy(policy: ProbabilisticTensorDictSequential) -> bool:
    # Of a function that builds distributions nothing is known: it is believed, and may raise.
    return getattr(_distribution_class(policy), "entropy", None) is not Distribution.entropy


def _kl(old: Distribution, new: Distribution) -> Tensor:
    """KL(old || new), ``[...]``; of tanh-Gaussians that of their Gaussians: tanh is a bijection."""
    if isinstance(old, TanhNormal) and isinstance(new, TanhNormal):
        for bound in ("low", "high"):
            of_old, of_new = getattr(old, bound), getattr(new, bound)
            if not torch.equal(of_old, of_new):
                raise ValueError(
                    f"the KL of two TanhNormal needs one range of actions, got {bound} {of_old} at "
                    f"collection and {of_new} now"
                )
        return kl_divergence(old.base_dist, new.base_dist)
    return kl_divergence(old, new)
