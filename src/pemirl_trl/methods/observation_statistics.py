"""A policy's map of observations that follows what it sees."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from pemirl_trl.modules import Standardize


class ObservationStatistics:
    """Mean and deviation of all observations so far, written into a map of observations.

    A map that is fitted to random actions alone can be far off: where they hardly move an object,
    its position is scaled by a deviation of millimetres, and saturates the units of a policy that
    has learned to move it.

    Counts, means and sums of squares are merged exactly, in float64 (Chan, Golub and LeVeque,
    1983).

    Args:
        standardize: changed in place by :meth:`update`.
    """

    def __init__(self, standardize: Standardize) -> None:
        self.standardize = standardize
        self._count = 0
        self._mean = torch.zeros(standardize.features, dtype=torch.float64)
        self._squares = torch.zeros(standardize.features, dtype=torch.float64)

    @torch.no_grad()
    def update(self, observations: Tensor) -> None:
        """Take ``observations`` ``[..., S]`` in; a feature that never varied keeps scale 1."""
        rows = observations.reshape(-1, self.standardize.features).double().cpu()
        mean, count = rows.mean(0), self._count + len(rows)
        shift = mean - self._mean
        self._squares += (rows - mean).square().sum(0)
        self._squares += shift.square() * self._count * len(rows) / count
        self._mean += shift * len(rows) / count
        self._count = count
        fitted = Standardize.from_moments(self._mean, self._squares / max(1, count - 1))
        self.standardize.load_state_dict(fitted.state_dict())

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {"count": self._count, "mean": self._mean, "squares": self._squares}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue a run."""
        self._count = int(state["count"])
        self._mean, self._squares = state["mean"].clone(), state["squares"].clone()
