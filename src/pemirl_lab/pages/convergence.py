"""How many environment steps training took to converge."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from pemirl_lab.pages.tables import MISSING, by_seed, markdown_table, millions
from pemirl_lab.results import Result, Score, normalised_return

__all__ = ["Stage", "convergence_table", "steps_to_converge"]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A learning curve of a row.

    Args:
        row: of the results.
        stage: name of the curve in ``Result.curves``.
        variant: dynamics under which its returns were earned.
        label: what it is called.
        paper: published environment steps to convergence.
    """

    row: str
    stage: str
    variant: str
    label: str
    paper: float | None = None


def steps_to_converge(
    curve: Sequence[Sequence[float]], expert: float, random: float, fraction: float = 0.95
) -> float | None:
    """First environment step from which the return stays at random + fraction (expert - random).

    Args:
        curve: ``(environment steps, return)``, steps increasing.
        expert, random: returns of the expert and of the random policy.
        fraction: of the way from the random policy to the expert.

    Returns:
        None if the curve ends below, or is empty.

    Raises:
        ValueError: the expert is no better than the random policy.
    """
    converged = None
    for steps, value in reversed(curve):
        if normalised_return(value, random, expert) < fraction:
            break
        converged = steps
    return converged


def convergence_table(
    results: Sequence[Result], stages: Sequence[Stage], fraction: float = 0.95
) -> str:
    """Environment steps to converge (:func:`steps_to_converge`), the median over seeds.

    A seed that never does counts as slower than all others. Expert and random policy are those of
    a score of all goals under the dynamics of the stage.

    Raises:
        ValueError: a run has the curve, but no such score.
    """
    lines = []
    for stage in stages:
        found = []
        for run in by_seed(results, stage.row).values():
            if stage.stage in run.curves:
                score, curve = _reference(run, stage), run.curves[stage.stage]
                steps = steps_to_converge(curve, score.expert, score.random, fraction)
                found.append(math.inf if steps is None else steps)
        if found:
            reached = sum(math.isfinite(steps) for steps in found)
            paper = MISSING if stage.paper is None else millions(stage.paper)
            median, every = millions(statistics.median(found)), ", ".join(map(millions, found))
            lines.append([stage.label, median, f"{reached} of {len(found)}", every, paper])
    return markdown_table(["", "steps, median", "seeds that do", "every seed", "paper"], lines)


def _reference(run: Result, stage: Stage) -> Score:
    for score in run.scores:
        if (score.variant, score.goals) == (stage.variant, "all"):
            return score
    known = sorted({(score.variant, score.goals) for score in run.scores})
    raise ValueError(
        f"row {run.row!r} has a curve {stage.stage!r}, but no score of all goals under "
        f"{stage.variant!r} to measure it against; its scores are of {known}"
    )
