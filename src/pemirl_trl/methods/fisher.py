"""The Fisher information of a Gaussian policy, by its products with vectors, in closed form."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeGuard

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from pemirl_trl.functional.linearisation import pull_back, push_forward
from pemirl_trl.modules import ContextPolicy
from pemirl_trl.modules.context_encoder import diagonal_normal
from pemirl_trl.modules.model import Policy

FisherProduct = Callable[[Tensor], Tensor]


def has_closed_form(policy: Policy) -> TypeGuard[ContextPolicy]:
    """Whether :func:`gaussian_fisher_product` knows the policy's Fisher information.

    It does if the policy is a diagonal Gaussian whose mean is an MLP of ReLUs or of tanhs, all of
    it trained, and whose deviation is held. (One that is trained would have a simple part as well,
    2 I in log sigma; but there this and autograd differ in the last bits, on which published runs
    depend. With a held one they do not.)
    """
    if type(policy) is not ContextPolicy or policy[-1].distribution_class is not diagonal_normal:
        return False
    net = policy.gaussian.net
    layers = (nn.Linear, nn.ReLU, nn.Tanh)
    return (
        not policy.log_scale.requires_grad
        and all(type(layer) in layers for layer in net)
        and all(parameter.requires_grad for parameter in net.parameters())
    )


@torch.no_grad()
def gaussian_fisher_product(policy: ContextPolicy, batch: TensorDictBase) -> FisherProduct:
    r"""Return v -> F v, with F the Hessian of the mean KL(pi_old || pi) at pi = pi_old.

    For pi = N(mu_w(s, m), diag(sigma^2)) with sigma held, F is the mean over the batch of
    J^T diag(1 / sigma^2) J, with J the Jacobian of mu in w (Amari, 1998, "Natural Gradient Works
    Efficiently in Learning", https://doi.org/10.1162/089976698300017746). One product is one pass
    forward and one back; a KL that autograd differentiates twice gives the same at twice the cost.

    Args:
        policy: one that :func:`has_closed_form`; at pi_old for as long as products are taken.
        batch: ``[B]``, what the policy reads.

    Returns:
        A function of vectors ``[P]``, in the order of the policy's trained parameters, without
        damping.
    """
    gaussian = policy.gaussian
    inputs, slopes = gaussian.linearised(batch[policy.observation_key], batch[policy.context_key])
    weights = [layer.weight for layer in gaussian.net if isinstance(layer, nn.Linear)]
    sizes = [p.numel() for p in gaussian.net.parameters()]
    scale = gaussian.log_scale.exp()

    @torch.no_grad()
    def product(vector: Tensor) -> Tensor:
        moves = [
            part.view_as(parameter)
            for parameter, part in zip(gaussian.net.parameters(), vector.split(sizes), strict=True)
        ]  # weight, bias, weight, bias, ...
        of_mean = push_forward(inputs, slopes, weights, moves[::2], moves[1::2])
        # In autograd's order, for the sake of the last bits.
        of_kl = of_mean.div_(scale).mul_(1.0 / len(batch)).div_(scale)
        of_weights, of_biases = pull_back(inputs, slopes, weights, of_kl)
        of_layers = zip(of_weights, of_biases, strict=True)
        return torch.cat([part.reshape(-1) for pair in of_layers for part in pair])

    return product
