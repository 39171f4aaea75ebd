"""Closed forms of the diagonal Gaussian."""

from __future__ import annotations

from torch import Tensor


def kl_to_standard_normal(loc: Tensor, scale: Tensor) -> Tensor:
    r"""KL(N(loc, diag(scale^2)) || N(0, I)) = 1/2 sum_d (scale_d^2 + loc_d^2 - 1) - log scale_d.

    Args:
        loc, scale: ``[..., D]``.

    Returns:
        ``[...]``, in nats.
    """
    return (0.5 * (scale.square() + loc.square() - 1.0) - scale.log()).sum(-1)
