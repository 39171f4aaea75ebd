"""How much of the gap that changed dynamics open is closed by adaptation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import fmean

from pemirl_lab.pages.tables import (
    Column,
    Rows,
    by_seed,
    interval_text,
    markdown_table,
    scores_of,
)
from pemirl_lab.results import Result
from pemirl_trl.evaluation.statistics import seeds_interval

__all__ = ["best_known", "gap_closed", "gap_table"]

_YARDSTICKS = ("expert", "rl_with_true_reward")
"""Settings of policies that know the true reward."""


def gap_closed(adapted: float, carried_over: float, best: float) -> float:
    """``(adapted - carried over) / (best - carried over)`` of mean returns.

    0 is the policy carried over, 1 the best that is known. Unlike a return that is normalised by
    the random policy, it owes nothing to what the policy could do before.

    Raises:
        ValueError: the best is no better than the policy carried over.
    """
    if not best > carried_over:
        raise ValueError(f"the best return {best} is not above the one carried over {carried_over}")
    return (adapted - carried_over) / (best - carried_over)


def best_known(results: Sequence[Result], variant: str, goals: str = "all") -> tuple[str, float]:
    """The row of the best policy that knows the true reward, and its return, the mean over seeds.

    Raises:
        ValueError: nothing that knows the true reward was measured there.
    """
    found = dict(_yardsticks(results, variant, goals))
    if not found:
        raise ValueError(f"no expert was measured under {variant!r}")
    best = max(found, key=lambda row: found[row])
    return best, found[best]


def _yardsticks(results: Sequence[Result], variant: str, goals: str) -> Iterator[tuple[str, float]]:
    for result in results:
        for score in result.scores:
            if (score.variant, score.goals) == (variant, goals):
                yield "expert", score.expert
    for row in sorted({result.row for result in results}):
        for setting in _YARDSTICKS:
            scores = scores_of(results, row, Column(setting=setting, variant=variant, goals=goals))
            if scores:
                yield row, fmean(score.mean for score in scores.values())


def gap_table(results: Sequence[Result], rows: Rows, *, variant: str, goals: str = "all") -> str:
    """The share of the gap that each row's adaptation closes, over seeds; and every seed's.

    A seed's gap is between its own policy carried over and the best known return.

    Args:
        results: of one comparison.
        rows: which, and their names; those without adaptation, or without a policy that was carried
            over, are left out.
        variant, goals: where it was measured.

    Raises:
        ValueError: see :func:`best_known` and :func:`gap_closed`.
    """
    lines = []
    for row, label in rows.items():
        means = [
            {seed: score.mean for seed, score in scores_of(results, row, column).items()}
            for column in (
                Column(setting=setting, variant=variant, goals=goals)
                for setting in ("policy_generalisation", "reward_adaptation")
            )
        ]
        carried, adapted = means
        seeds = [seed for seed in by_seed(results, row) if seed in carried and seed in adapted]
        if seeds:
            best = best_known(results, variant, goals)[1]
            shares = [gap_closed(adapted[seed], carried[seed], best) for seed in seeds]
            every = ", ".join(f"{share:z.2f}" for share in shares)
            lines.append([label, str(len(seeds)), interval_text(seeds_interval(shares)), every])
    if not lines:
        return ""
    name, value = best_known(results, variant, goals)
    label = rows.get(name, name.replace("_", " "))
    heading = f"share of the gap closed, {variant} (best known: {label}, {value:z.2f})"
    return markdown_table(["", "seeds", heading, "every seed"], lines)
