"""Closed forms of the diagonal Gaussian."""

from __future__ import annotations

from torch import Tensor


def kl_to_standard_normal(loc: Tensor, scale: Tensor) -> Tensor:
    r"""Compute KL(N(loc, diag(scale^2)) || N(0, I)), in closed form.

    It is sum_d (scale_d^2 + loc_d^2 - 1) / 2 - log scale_d. torch's ``kl_divergence`` of two
    ``Normal`` is the same equation in another order: it and its gradient differ in the last bits,
    on which published runs depend.

    Args:
        loc, scale: ``[..., D]``; the scale is the deviation.

    Returns:
        ``[...]``, in nats.
    """
    return (0.5 * (scale.square() + loc.square() - 1.0) - scale.log()).sum(-1)
