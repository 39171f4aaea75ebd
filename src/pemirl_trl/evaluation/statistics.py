"""Statistics over seeds and tasks: intervals, aggregates, correlations. SciPy does the work."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from torch import Tensor

__all__ = [
    "Interval",
    "iqm",
    "iqm_interval",
    "pearson",
    "probability_of_improvement",
    "seeds_interval",
    "spearman",
    "t_interval",
]

Array = NDArray[np.float64]

FEWEST_TO_RESAMPLE = 10
"""Seeds from which on an interval is bootstrapped."""
_TRIMMED = 0.25  # from each end: the interquartile mean
_BATCH = 1000  # resamples whose statistic is computed at once, for memory's sake


class Interval(NamedTuple):
    """An estimate and its confidence interval; ``low`` and ``high`` are NaN for a single value."""

    estimate: float
    low: float
    high: float


def t_interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """Mean and Student-t interval: for few values that are about normal, such as seeds.

    Raises:
        ValueError: no values, values that are not finite, or a confidence outside (0, 1).
    """
    sample = _sample(values, confidence)
    mean, n = float(sample.mean()), len(sample)
    if n == 1:
        return Interval(mean, math.nan, math.nan)
    half = float(stats.t.ppf((1 + confidence) / 2, n - 1)) * float(sample.std(ddof=1)) / n**0.5
    return Interval(mean, mean - half, mean + half)


def seeds_interval(values: ArrayLike, *, resamples: int = 10_000) -> Interval:
    """What seeds say together: their mean with Student's t, or, of ten and more, their IQM.

    The bootstrap resamples what was seen: with 3 seeds its 95 % interval covers the truth in 76 %
    of cases, with 5 in 90 %, and from 10 on in about what it promises. Student's t covers what it
    promises at any number, where seeds are about normal.

    Raises:
        ValueError: no values, or values that are not finite.
    """
    sample = _sample(values, 0.95)
    if len(sample) < FEWEST_TO_RESAMPLE:
        return t_interval(sample)
    return iqm_interval(sample.tolist(), resamples=resamples)


def iqm(values: ArrayLike) -> float:
    """Interquartile mean: the mean without the lowest and the highest quarter, rounded down.

    Of fewer than four values it is their mean. (Agarwal et al., NeurIPS 2021, "Deep Reinforcement
    Learning at the Edge of the Statistical Precipice", Section 4.3.)
    """
    return float(stats.trim_mean(np.asarray(values, np.float64).ravel(), _TRIMMED))


def iqm_interval(
    strata: Sequence[float] | Sequence[Sequence[float]] | Tensor,
    confidence: float = 0.95,
    *,
    resamples: int = 10_000,
    seed: int = 0,
) -> Interval:
    """Interquartile mean of all values pooled, with a stratified percentile-bootstrap interval.

    What is resampled, with replacement and within each stratum, are runs: one value is one seed's
    (say, its mean over tasks), and a stratum is a domain, a setting or a method. The tasks of one
    seed are no strata and no values: they share a policy, so they are not independent, and
    resampling them would promise a precision that other seeds do not keep.
    (Agarwal et al., NeurIPS 2021, Section 4.1.)

    Args:
        strata: one value per seed; or one such list per stratum, of any lengths.
        confidence: of the interval.
        resamples: bootstrap samples.
        seed: of the resampling.

    Returns:
        The interval; its ends are NaN where a stratum has a single value, and so shows no spread.

    Raises:
        ValueError: no values, values that are not finite, or a confidence outside (0, 1).
    """
    nested = len(strata) > 0 and np.ndim(strata[0]) > 0
    samples = [_sample(values, confidence) for values in (strata if nested else [strata])]

    def pooled(*values: Array, axis: int) -> Array:
        return np.asarray(stats.trim_mean(np.concatenate(values, axis), _TRIMMED, axis))

    return _bootstrap(samples, pooled, confidence, resamples, seed)


def probability_of_improvement(
    x: ArrayLike,
    y: ArrayLike,
    confidence: float = 0.95,
    *,
    resamples: int = 10_000,
    seed: int = 0,
) -> Interval:
    """P(X > Y) + P(X = Y) / 2, with a percentile-bootstrap interval.

    It is Mann and Whitney's U over n m, the number of pairs; that is (1 + E sign(X - Y)) / 2. Both
    samples are resampled, independently. (Agarwal et al., NeurIPS 2021, Section 4.3.)

    Args:
        x: one value per seed ``[n]`` of the method that may be better.
        y: one value per seed ``[m]`` of the other.
        confidence: of the interval.
        resamples: bootstrap samples.
        seed: of the resampling.

    Returns:
        The interval; its ends are NaN where ``x`` or ``y`` is a single value.

    Raises:
        ValueError: no values, values that are not finite, or a confidence outside (0, 1).
    """

    def above(x: Array, y: Array, axis: int) -> Array:
        del axis  # it is the last one
        pairs = np.sign(x[..., :, None] - y[..., None, :])
        return np.asarray((1 + pairs.mean((-2, -1))) / 2)

    return _bootstrap([_sample(v, confidence) for v in (x, y)], above, confidence, resamples, seed)


def pearson(x: Tensor, y: Tensor) -> Tensor:
    """Linear correlation along the last dimension.

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
    a, b = (_unit(values.double()) for values in (x, y))
    return (a * b).sum(-1).clamp(-1, 1)


def spearman(x: Tensor, y: Tensor) -> Tensor:
    """Spearman's rank correlation along the last dimension; ties share the mean of their ranks.

    Args:
        x: ``[..., n]``.
        y: ``[..., n]``.

    Returns:
        ``[...]`` float64 in [-1, 1]; NaN where one of the two is constant.

    Raises:
        ValueError: shapes differ, or a value is NaN.
    """
    ranks = (torch.from_numpy(stats.rankdata(v.numpy(force=True), axis=-1)) for v in (x, y))
    # A NaN among the values makes every rank of its row NaN, so pearson refuses it.
    return pearson(*ranks)


def _unit(values: Tensor) -> Tensor:
    """Centred vectors of length 1; NaN where constant, which rounding in the mean could hide."""
    constant = values.amax(-1, keepdim=True) == values.amin(-1, keepdim=True)
    centred = values - values.mean(-1, keepdim=True)
    return (centred / centred.norm(dim=-1, keepdim=True)).masked_fill(constant, math.nan)


def _sample(values: ArrayLike, confidence: float) -> Array:
    sample = np.asarray(values, np.float64)
    if sample.ndim != 1 or sample.size == 0 or not np.isfinite(sample).all():
        raise ValueError(f"got values {sample.tolist()}; expected a list of finite numbers")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is {confidence}; expected a number between 0 and 1")
    return sample


def _bootstrap(
    samples: Sequence[Array],
    statistic: Callable[..., Array],
    confidence: float,
    resamples: int,
    seed: int,
) -> Interval:
    """Percentile interval of ``statistic(*samples, axis)``; the samples are strata."""
    estimate = float(statistic(*samples, axis=-1))
    if any(len(sample) == 1 for sample in samples):
        return Interval(estimate, math.nan, math.nan)
    interval = stats.bootstrap(
        samples,
        statistic,
        confidence_level=confidence,
        n_resamples=resamples,
        batch=_BATCH,
        method="percentile",
        vectorized=True,
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return Interval(estimate, float(interval.low), float(interval.high))
