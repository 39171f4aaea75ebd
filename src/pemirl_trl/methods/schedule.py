"""How a positive number moves over a training."""

from __future__ import annotations


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
