"""How a positive number moves over a training: the one schedule for all that is annealed."""

from __future__ import annotations

import math

from torch import Tensor


def log_linear(
    start: float, end: float, progress: float, *, begin: float = 0.0, finish: float = 1.0
) -> float:
    """``start`` until ``begin``, ``end`` from ``finish``, and a geometric path in between.

    Args:
        start, end: positive.
        progress: share of the training that is done, in [0, 1].
        begin, finish: shares between which the number moves; ``begin < finish``.

    Raises:
        ValueError: a number that is not positive, or an empty stretch.
    """
    if not (start > 0 and end > 0 and begin < finish):
        raise ValueError(
            f"got start {start}, end {end}, begin {begin} and finish {finish}; expected positive "
            "start and end, and begin < finish"
        )
    share = min(1.0, max(0.0, (progress - begin) / (finish - begin)))
    return float(start * (end / start) ** share)


class AnnealedScale:
    """A policy's deviation, forced along :func:`log_linear` instead of being learned.

    Of a policy of discrete actions it is the share of them that is drawn uniformly.

    Args:
        log_scale: the policy's parameter; it is taken out of the learner's hands.
        final_scale: where the deviation ends; None leaves the parameter alone.
        begin, finish: shares of the training between which it moves.
    """

    def __init__(
        self, log_scale: Tensor, final_scale: float | None, begin: float, finish: float
    ) -> None:
        self.log_scale, self.final_scale = log_scale, final_scale
        self.begin, self.finish = begin, finish
        self._initial_scale = float(log_scale.detach().exp().mean())
        if final_scale is not None:
            log_scale.requires_grad_(False)

    def move(self, progress: float) -> None:
        """Set the deviation for ``progress``, the share of the training that is done."""
        if self.final_scale is not None:
            stretch = {"begin": self.begin, "finish": self.finish}
            scale = log_linear(self._initial_scale, self.final_scale, progress, **stretch)
            self.log_scale.data.fill_(math.log(scale))
