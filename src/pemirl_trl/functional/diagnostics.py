"""What tells a sound training from a failing one, in numbers."""

from __future__ import annotations

import torch
from torch import Tensor


def channel_information(loc: Tensor, scale: Tensor) -> Tensor:
    r"""Compute what one draw of m tells about which of J demonstrations it was drawn from.

    It is sum_d log(1 + Var_j(loc_d) / E_j(scale_d^2)) / 2, the capacity of a Gaussian channel with
    that signal and that noise (Cover and Thomas, 2006, "Elements of Information Theory", Section
    9.1), which bounds the mutual information where means are Gaussian and components independent.
    Unlike KL(q || N(0, I)) it is 0 wherever all demonstrations have the same q.

    Args:
        loc, scale: of q(m | tau_j), ``[J, D]``; the scale is the deviation.

    Returns:
        A scalar, in nats.
    """
    signal = loc.var(0, correction=0)
    return 0.5 * torch.log1p(signal / scale.square().mean(0)).sum()


def share_between_groups(values: Tensor) -> Tensor:
    r"""Compute the share of the spread of ``[M, K]`` values that their M groups explain.

    The intraclass correlation of one-way analysis of variance, (B - W) / (B + (K - 1) W) with the
    mean squares between and within groups (Fisher, 1925, "Statistical Methods for Research
    Workers", Section 38), not below 0; 0 where nothing spreads.

    Returns:
        A scalar between 0 and 1.

    Raises:
        ValueError: fewer than two groups, or than two values in each.
    """
    groups, size = values.shape
    if groups < 2 or size < 2:
        raise ValueError(f"got [{groups}, {size}] values; expected at least two groups of two")
    between = size * values.mean(1).var()
    within = values.var(1).mean()
    spread = between + (size - 1) * within
    share = ((between - within) / spread).clamp(min=0.0)
    return torch.where(spread > 0, share, torch.zeros_like(share))


def dependence_on_context(own: Tensor, other: Tensor) -> Tensor:
    r"""Compute how much of r's variance moves with m: E (r(s, m) - r(s, m'))^2 / 2 Var r(s, m).

    0 where r does not read m, about 1 where nothing else matters; m' is another context than the
    one that s was reached under. (The pick-freeze form of a total Sobol index: Saltelli et al.,
    2010, "Variance based sensitivity analysis of model output".)

    Args:
        own, other: r(s, m) and r(s, m') of the same states, ``[B]``.

    Returns:
        A scalar, at least 0; 0 where r is a constant.
    """
    variance = own.var(correction=0)
    moved = 0.5 * (own - other).square().mean()
    return torch.where(moved + variance > 0, moved / variance.clamp_min(1e-12), moved)
