"""The binary classification of expert and policy transitions, for AIRL and for GAIL."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictParams, dispatch
from tensordict.utils import NestedKey
from torch import Tensor

from pemirl_trl.functional import binary_classification_loss
from pemirl_trl.modules import AIRLDiscriminator, GAILDiscriminator
from pemirl_trl.objectives.common import KeyedLoss


class DiscriminatorLoss(KeyedLoss):
    r"""Cross-entropy of D over expert and policy transitions, for the discriminator's parameters.

    ``loss_discriminator`` = mean over the batch of softplus(-logit) on expert transitions and
    softplus(logit) on policy transitions (Algorithm 1, Yu et al., 2019). Give both in equal number.

    ``loss_gradient_penalty`` = c (E_policy |grad_s r|^2 + E_expert |grad_s r|^2), the R1
    penalty of Mescheder et al. (2018) on r alone, the gradient taken in standardised
    observations. It is an extension of the paper and present only where c > 0.

    Metrics (detached): ``accuracy``, ``logit_expert_mean``, ``logit_policy_mean``.

    Args:
        discriminator: gives ``logit_expert``; its ``roles`` say what it reads.
        detach_context: whether m is data. With False, a context drawn by ``rsample`` carries
            this loss's gradient to the encoder psi, as in the authors' code.
        gradient_penalty_coeff: c.
        reduction: ``"mean"``, ``"sum"`` or ``"none"`` of ``loss_discriminator``.
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
        super().__init__()
        self.convert_to_functional(
            discriminator, "discriminator_network", create_target_params=False
        )
        self.detach_context = detach_context
        self.gradient_penalty_coeff = gradient_penalty_coeff
        self.reduction = reduction
        penalty = ["loss_gradient_penalty"] if gradient_penalty_coeff > 0 else []
        metrics = ["accuracy", "logit_expert_mean", "logit_policy_mean"]
        self.out_keys = ["loss_discriminator", *penalty, *metrics]

    def _input_keys(self) -> list[NestedKey]:
        roles = (*self.discriminator_network.roles, "is_expert")
        return [getattr(self.tensor_keys, role) for role in roles]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute the losses.

        Args:
            tensordict: any batch size ``[...]``, with what the discriminator reads (``observation``
                and some of ``("next", "observation")``, ``action``, ``context``,
                ``action_log_prob``) and boolean ``is_expert``, ``[...]`` or ``[..., 1]``.
        """
        roles = self.discriminator_network.roles
        values = {role: tensordict[getattr(self.tensor_keys, role)] for role in roles}
        is_expert = tensordict[self.tensor_keys.is_expert]
        for role in ("action_log_prob", *(("context",) if self.detach_context else ())):
            if role in values:
                values[role] = values[role].detach()
        penalised = self.gradient_penalty_coeff > 0 and torch.is_grad_enabled()
        if penalised:
            values["observation"] = values["observation"].detach().requires_grad_()
        names = self.discriminator_network.in_keys
        inputs = TensorDict(dict(zip(names, values.values(), strict=True)), tensordict.batch_size)
        with self.discriminator_network_params.to_module(
            self.discriminator_network, preserve_module_state=False
        ):
            outputs = self.discriminator_network(inputs)
            scale = self.discriminator_network.standardize.scale
        logit = outputs[self.discriminator_network.out_keys[-1]]
        is_expert = is_expert.view(logit.shape).bool()
        loss = binary_classification_loss(logit, is_expert).squeeze(-1)
        result = TensorDict({"loss_discriminator": self._reduce_loss(loss, tensordict)})
        if penalised:
            reward = outputs[self.discriminator_network.out_keys[0]]
            penalty = _squared_slope(reward, values["observation"], scale, is_expert)
            result["loss_gradient_penalty"] = self.gradient_penalty_coeff * penalty
        elif self.gradient_penalty_coeff > 0:
            result["loss_gradient_penalty"] = torch.zeros(())
        return result.update(_metrics(logit.detach(), is_expert))


def _squared_slope(reward: Tensor, observation: Tensor, scale: Tensor, is_expert: Tensor) -> Tensor:
    (gradient,) = torch.autograd.grad(reward.sum(), observation, create_graph=True)
    squared = (gradient * scale).square().sum(-1, keepdim=True)
    return _mean_where(squared, is_expert) + _mean_where(squared, ~is_expert)


def _mean_where(values: Tensor, mask: Tensor) -> Tensor:
    return torch.where(mask, values, 0.0).sum() / mask.sum().clamp_min(1)


def _metrics(logit: Tensor, is_expert: Tensor) -> dict[str, Tensor]:
    return {
        "accuracy": ((logit > 0) == is_expert).float().mean(),
        "logit_expert_mean": _mean_where(logit, is_expert),
        "logit_policy_mean": _mean_where(logit, ~is_expert),
    }
