"""Means with confidence intervals, over few seeds or many tasks, and rank correlation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["Interval", "average_ranks", "bootstrap_interval", "spearman", "t_interval"]


class Interval(NamedTuple):
    """A mean and its confidence interval; ``low`` and ``high`` are NaN for a single value."""

    mean: float
    low: float
    high: float


def _sample(values: Tensor | Sequence[float], confidence: float) -> Tensor:
    sample = torch.as_tensor(values, dtype=torch.float64)
    if sample.ndim != 1 or sample.numel() == 0 or not bool(torch.isfinite(sample).all()):
        raise ValueError(f"got values {sample.tolist()}; expected a list of finite numbers")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is {confidence}; expected a number between 0 and 1")
    return sample


def _student_t_quantile(confidence: float, dof: int) -> float:
    r"""Solve :math:`P(|T_\nu| \le t) = ` ``confidence`` for t, by bisection.

    With :math:`\theta = \arctan(t / \sqrt\nu)` the probability is a finite sum (Abramowitz and
    Stegun, Handbook of Mathematical Functions, 26.7.3 and 26.7.4).
    """

    def probability(theta: float) -> float:
        sine, cosine = math.sin(theta), math.cos(theta)
        odd = dof % 2
        term = cosine if odd else 1.0
        total = 0.0
        for k in range(2 + odd, dof + 1, 2):
            total += term
            term *= cosine**2 * (k - 1) / k
        return 2 / math.pi * (theta + sine * total) if odd else sine * total

    low, high = 0.0, math.pi / 2
    for _ in range(100):  # more halvings than a double has bits
        middle = (low + high) / 2
        low, high = (middle, high) if probability(middle) < confidence else (low, middle)
    return math.sqrt(dof) * math.tan(low)


def t_interval(values: Tensor | Sequence[float], confidence: float = 0.95) -> Interval:
    """Mean and Student-t interval: for few values that are about normal, such as seeds.

    Raises:
        ValueError: no values, values that are not finite, or a confidence outside (0, 1).
    """
    sample = _sample(values, confidence)
    mean, n = sample.mean().item(), sample.numel()
    if n == 1:
        return Interval(mean, math.nan, math.nan)
    half = _student_t_quantile(confidence, n - 1) * sample.std().item() / math.sqrt(n)
    return Interval(mean, mean - half, mean + half)


def bootstrap_interval(
    values: Tensor | Sequence[float],
    confidence: float = 0.95,
    *,
    resamples: int = 10_000,
    seed: int = 0,
) -> Interval:
    """Mean and percentile-bootstrap interval: for some twenty values or more, such as tasks.

    Too narrow for a handful of seeds; use :func:`t_interval` there.

    Raises:
        ValueError: no values, values that are not finite, or a confidence outside (0, 1).
    """
    sample = _sample(values, confidence)
    mean, n = sample.mean().item(), sample.numel()
    if n == 1:
        return Interval(mean, math.nan, math.nan)
    generator = torch.Generator().manual_seed(seed)
    means = sample[torch.randint(n, (resamples, n), generator=generator)].mean(1)
    tail = (1 - confidence) / 2
    low, high = means.quantile(torch.tensor([tail, 1 - tail], dtype=torch.float64)).tolist()
    return Interval(mean, low, high)


def average_ranks(values: Tensor) -> Tensor:
    """Rank along the last dimension, from 0, ties sharing the mean of their ranks.

    Args:
        values: ``[..., n]``.

    Returns:
        ``[..., n]`` float64.
    """
    values = values.contiguous()
    ordered = values.sort(-1).values
    below = torch.searchsorted(ordered, values)
    not_above = torch.searchsorted(ordered, values, right=True)
    return (below + not_above - 1).double() / 2


def spearman(x: Tensor, y: Tensor) -> Tensor:
    """Spearman's rank correlation along the last dimension, ties included.

    Args:
        x: ``[..., n]``.
        y: ``[..., n]``.

    Returns:
        ``[...]`` float64 in [-1, 1]; NaN where one of the two is constant.

    Raises:
        ValueError: shapes differ, or a value is NaN.
    """
    if x.shape != y.shape or bool(x.isnan().any() or y.isnan().any()):
        raise ValueError(
            f"got shapes {tuple(x.shape)} and {tuple(y.shape)}; expected equal ones, without NaN"
        )
    a, b = (ranks - ranks.mean(-1, keepdim=True) for ranks in map(average_ranks, (x, y)))
    return (a * b).sum(-1) / (a.norm(dim=-1) * b.norm(dim=-1))
