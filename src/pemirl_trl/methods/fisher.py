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
    it trained; the deviation may be trained or held.
    """
    if type(policy) is not ContextPolicy or policy[-1].distribution_class is not diagonal_normal:
        return False
    net = policy.gaussian.net
    layers = (nn.Linear, nn.ReLU, nn.Tanh)
    return all(type(layer) in layers for layer in net) and all(
        parameter.requires_grad for parameter in net.parameters()
    )


@torch.no_grad()
def gaussian_fisher_product(policy: ContextPolicy, batch: TensorDictBase) -> FisherProduct:
    r"""Return v -> F v, with F the Hessian of the mean KL(pi_old || pi) at pi = pi_old.

    For pi = N(mu_w(s, m), diag(sigma^2)) F has two blocks: the mean over the batch of
    J^T diag(1 / sigma^2) J for w, with J the Jacobian of mu, and 2 I for log sigma, where that is
    trained (Amari, 1998, "Natural Gradient Works Efficiently in Learning",
    https://doi.org/10.1162/089976698300017746). One product is one pass forward and one back; a KL
    that autograd differentiates twice gives the same at more than twice the cost: the same bits
    with a held deviation, and up to rounding with a trained one.

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
    trained = list(gaussian.net.parameters())
    scale = gaussian.log_scale.exp()
    # A module lists its own parameters before those of its parts: log sigma, where trained, first.
    of_scale = scale.numel() if gaussian.log_scale.requires_grad else 0
    sizes = [of_scale, *(p.numel() for p in trained)]

    @torch.no_grad()
    def product(vector: Tensor) -> Tensor:
        log_scale_change, *parts = vector.split(sizes)
        # weight, bias, weight, bias, ...
        moves = [part.view_as(weight) for weight, part in zip(trained, parts, strict=True)]
        of_mean = push_forward(inputs, slopes, weights, moves[::2], moves[1::2])
        # In autograd's order, for the sake of the last bits.
        of_kl = of_mean.div_(scale).mul_(1.0 / len(batch)).div_(scale)
        of_weights, of_biases = pull_back(inputs, slopes, weights, of_kl)
        of_layers = zip(of_weights, of_biases, strict=True)
        of_net = [part.reshape(-1) for pair in of_layers for part in pair]
        return torch.cat([2.0 * log_scale_change, *of_net])

    return product
