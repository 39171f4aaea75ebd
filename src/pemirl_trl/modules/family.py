"""What a model was trained on, and how far something else is from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

FAR = 3.0
"""Deviations outside of the range seen in training from which an observed number counts as far."""


@dataclass(frozen=True)
class FamilyDistance:
    """How far a demonstration is from those of training; see :class:`TrainingFamily`.

    Attributes:
        context: Mahalanobis distance of m, in deviations.
        context_in_training: the largest one among the demonstrations of training.
        beyond: share of the observed numbers that are more than :data:`FAR` training deviations
            outside of the range of training.
        worst: the largest such excess, in training deviations; 0 within the range.
        worst_feature: which component of an observation has it.
    """

    context: float
    context_in_training: float
    beyond: float
    worst: float
    worst_feature: int

    @property
    def far(self) -> bool:
        """Whether m is twice as far out as any of training, or an observed number is far."""
        return self.context > 2.0 * self.context_in_training or self.worst > FAR

    def __str__(self) -> str:
        """Return it in one line."""
        verdict = "FAR from the training family" if self.far else "within the training family"
        return (
            f"{verdict}: m at {self.context:.2f} deviations (training: up to "
            f"{self.context_in_training:.2f}); observations at most {self.worst:.1f} training "
            f"deviations out of range (component {self.worst_feature}), {100 * self.beyond:.1f} % "
            f"of them more than {FAR:g}"
        )


@dataclass(frozen=True, eq=False)
class TrainingFamily:
    """Statistics of the demonstrations that a model was trained on.

    Two measures say whether r(s, m) may be believed for another demonstration. The Mahalanobis
    distance of its m from those of training: q maps a demonstration of something else to wherever
    its network extrapolates. And by how many training deviations what it observes leaves the range
    of training. Neither sees a gap inside the family: between two clusters of contexts, m is near.

    Attributes:
        context_mean, context_covariance: ``[D]`` and ``[D, D]``, of the means of q.
        context_distance: the largest distance in training, in deviations.
        low, high, deviation: ``[S]``, of the observations; a constant's deviation is that of the
            model's map of observations.
        recovered, outdone, displaced: what was measured of the trained model without labels
            (``recovered_share`` and ``sharpness`` of ``pemirl_trl.methods.consistency``); None
            where that was not.
    """

    context_mean: Tensor
    context_covariance: Tensor
    context_distance: float
    low: Tensor
    high: Tensor
    deviation: Tensor
    recovered: float | None = None
    outdone: float | None = None
    displaced: float | None = None

    @classmethod
    def fit(cls, contexts: Tensor, observations: Tensor, deviation: Tensor) -> Self:
        """Return the statistics of a training set.

        Args:
            contexts: ``[J, D]``, means of q(m | demonstration).
            observations: ``[J, T, S]``.
            deviation: ``[S]``, the units of observations (``model.standardize.scale``).

        Raises:
            ValueError: fewer than two demonstrations.
        """
        if len(contexts) < 2:
            raise ValueError(
                f"got {len(contexts)} demonstration; a family has at least 2, and commonly hundreds"
            )
        contexts, rows = contexts.detach(), observations.detach().flatten(0, -2)
        mean = contexts.mean(0)
        covariance = torch.atleast_2d(contexts.T.cov())
        distance = float(mahalanobis(contexts, mean, covariance).max())
        low, high = rows.amin(0), rows.amax(0)
        return cls(mean, covariance, distance, low, high, deviation.detach().clone())

    def excess(self, observations: Tensor) -> Tensor:
        """Training deviations by which ``[..., S]`` leave the range of training; 0 within it."""
        outside = torch.maximum(self.low - observations, observations - self.high)
        return outside.clamp(min=0) / self.deviation

    def distance(self, context: Tensor, observations: Tensor) -> FamilyDistance:
        """Measure one demonstration: its ``context`` ``[D]`` and ``observations`` ``[T, S]``."""
        excess = self.excess(observations).flatten(0, -2)
        worst = excess.amax(0)
        at = mahalanobis(context, self.context_mean, self.context_covariance)
        return FamilyDistance(
            context=float(at),
            context_in_training=self.context_distance,
            beyond=float((excess > FAR).float().mean()),
            worst=float(worst.max()),
            worst_feature=int(worst.argmax()),
        )


def mahalanobis(values: Tensor, mean: Tensor, covariance: Tensor) -> Tensor:
    """sqrt((x - mu)^T C^-1 (x - mu)) of ``[..., D]``: ``[...]``.

    A direction without variance counts with a thousandth of the largest deviation, so that a
    collapsed context makes no division by zero.
    """
    scale = covariance.diagonal().max().clamp(min=1e-12)
    regular = covariance + 1e-6 * scale * torch.eye(len(mean), dtype=covariance.dtype)
    difference = values - mean
    solved = torch.linalg.solve(regular, difference.unsqueeze(-1)).squeeze(-1)
    return (difference * solved).sum(-1).clamp(min=0).sqrt()
