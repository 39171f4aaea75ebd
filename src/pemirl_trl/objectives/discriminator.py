"""The binary classification of expert and policy transitions, for AIRL and for GAIL."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictParams, dispatch
from tensordict.utils import NestedKey
from torch import Tensor

from pemirl_trl.functional import binary_classification_loss
from pemirl_trl.modules import AIRLDiscriminator, GAILDiscriminator, ShapedReward
from pemirl_trl.modules.reading import DISCRIMINATOR
from pemirl_trl.objectives.common import KeyedLoss

METRICS = (
    *("accuracy", "accuracy_expert", "accuracy_policy"),
    *("logit_expert_mean", "logit_policy_mean", "loss_expert", "loss_policy"),
)


class DiscriminatorLoss(KeyedLoss):
    r"""Cross-entropy of D over expert and policy transitions, for the discriminator's parameters.

    ``loss_discriminator`` is the mean over the batch of softplus(-logit) on expert transitions and
    softplus(logit) on policy transitions, in nats: Algorithm 1 of Yu, Yu, Finn and Ermon (2019),
    "Meta-Inverse Reinforcement Learning with Probabilistic Context Variables", arXiv:1909.09314.
    Give both in equal number.

    ``loss_gradient_penalty`` is c (E_policy |grad_s r|^2 + E_expert |grad_s r|^2), the R1 penalty
    of Mescheder, Geiger and Nowozin (2018), "Which Training Methods for GANs do actually
    Converge?", arXiv:1801.04406, on r alone, the gradient taken in standardised observations. It
    is an extension of the paper and present only where c > 0.

    Metrics (detached): ``accuracy``, of all and of each side, and each side's mean logit and loss.

    The keys are those of the discriminator unless ``set_keys`` says otherwise.

    Args:
        discriminator: gives a logit at its ``logit_key`` and r at its ``reward_key``; its
            ``role_keys`` say what it reads, its ``standardize`` is its map of observations.
        detach_context: whether m is data. With False, a context drawn by ``rsample`` carries
            this loss's gradient to the encoder psi, as in the authors' code.
        gradient_penalty_coeff: c.
        reduction: ``"mean"``, ``"sum"`` or ``"none"`` of ``loss_discriminator``.

    Raises:
        TypeError: no discriminator was given.
        MissingKeyError: on a call, the batch lacks a key.

    Example:
        >>> from torch import randn, tensor
        >>> from tensordict import TensorDict
        >>> reward = ShapedReward(observation_dim=6, context_dim=3)
        >>> loss = DiscriminatorLoss(AIRLDiscriminator(reward))
        >>> batch = TensorDict(
        ...     {
        ...         "observation": randn(4, 6),
        ...         "next": {"observation": randn(4, 6)},
        ...         "context": randn(4, 3),
        ...         "action_log_prob": randn(4),
        ...         "is_expert": tensor([True, True, False, False]),
        ...     },
        ...     [4],
        ... )
        >>> sorted(key for key in loss(batch).keys() if key.startswith("loss"))
        ['loss_discriminator', 'loss_expert', 'loss_policy']
    """

    @dataclass
    class _AcceptedKeys:
        observation: NestedKey = "observation"
        next_observation: NestedKey = ("next", "observation")
        action: NestedKey = "action"
        context: NestedKey = "context"
        action_log_prob: NestedKey = "action_log_prob"
        is_expert: NestedKey = "is_expert"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys

    discriminator_network: AIRLDiscriminator | GAILDiscriminator
    discriminator_network_params: TensorDictParams
    target_discriminator_network_params: TensorDictParams

    def __init__(
        self,
        discriminator: AIRLDiscriminator | GAILDiscriminator,
        *,
        detach_context: bool = True,
        gradient_penalty_coeff: float = 0.0,
        reduction: str = "mean",
    ) -> None:
        wrap = "wrap it, AIRLDiscriminator(reward)"
        DISCRIMINATOR.required(discriminator, "DiscriminatorLoss", [(ShapedReward, wrap)])
        super().__init__()
        self.convert_to_functional(
            discriminator, "discriminator_network", create_target_params=False
        )
        self.detach_context = detach_context
        self.gradient_penalty_coeff = gradient_penalty_coeff
        self.reduction = reduction
        penalty = ["loss_gradient_penalty"] if gradient_penalty_coeff > 0 else []
        self.out_keys = ["loss_discriminator", *penalty, *METRICS]
        self.set_keys(**discriminator.role_keys)

    def _input_keys(self) -> list[NestedKey]:
        roles = (*self.discriminator_network.role_keys, "is_expert")
        return [getattr(self.tensor_keys, role) for role in roles]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute the losses.

        Args:
            tensordict: any batch size ``[...]``, with what the discriminator reads (``observation``
                and some of ``("next", "observation")``, ``action``, ``context``,
                ``action_log_prob``) and boolean ``is_expert``, ``[...]`` or ``[..., 1]``.

        Raises:
            MissingKeyError: the batch lacks one of ``in_keys``.
        """
        network = self.discriminator_network
        values = {role: self._read(tensordict, role) for role in network.role_keys}
        is_expert = self._read(tensordict, "is_expert")
        for role in ("action_log_prob", *(("context",) if self.detach_context else ())):
            if role in values:
                values[role] = values[role].detach()
        penalised = self.gradient_penalty_coeff > 0 and torch.is_grad_enabled()
        if penalised:
            values["observation"] = values["observation"].detach().requires_grad_()
        inputs = TensorDict(
            {network.role_keys[role]: value for role, value in values.items()},
            tensordict.batch_size,
        )
        with self.discriminator_network_params.to_module(network, preserve_module_state=False):
            outputs = network(inputs)
            scale = network.standardize.scale
        logit = outputs[network.logit_key]
        is_expert = is_expert.view(logit.shape).bool()
        loss = binary_classification_loss(logit, is_expert).squeeze(-1)
        result = TensorDict({"loss_discriminator": self._reduce_loss(loss, tensordict)})
        if penalised:
            reward = outputs[network.reward_key]
            penalty = _squared_slope(reward, values["observation"], scale, is_expert)
            result["loss_gradient_penalty"] = self.gradient_penalty_coeff * penalty
        elif self.gradient_penalty_coeff > 0:
            result["loss_gradient_penalty"] = torch.zeros_like(loss.mean())
        return result.update(_metrics(logit.detach(), is_expert))


def _squared_slope(reward: Tensor, observation: Tensor, scale: Tensor, is_expert: Tensor) -> Tensor:
    (gradient,) = torch.autograd.grad(reward.sum(), observation, create_graph=True)
    squared = (gradient * scale).square().sum(-1, keepdim=True)
    return _mean_where(squared, is_expert) + _mean_where(squared, ~is_expert)


def _mean_where(values: Tensor, mask: Tensor) -> Tensor:
    return torch.where(mask, values, 0.0).sum() / mask.sum().clamp_min(1)


def _metrics(logit: Tensor, is_expert: Tensor) -> dict[str, Tensor]:
    right = ((logit > 0) == is_expert).to(logit.dtype)
    loss = binary_classification_loss(logit, is_expert)
    sides = {"expert": is_expert, "policy": ~is_expert}
    return {
        "accuracy": right.mean(),
        **{f"accuracy_{side}": _mean_where(right, mask) for side, mask in sides.items()},
        **{f"logit_{side}_mean": _mean_where(logit, mask) for side, mask in sides.items()},
        **{f"loss_{side}": _mean_where(loss, mask) for side, mask in sides.items()},
    }
