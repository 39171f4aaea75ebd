"""What is suspicious about demonstrations that are well formed, and what to do about it.

A well-formed dataset can still be one that nobody can learn from: two episodes glued together,
actions in degrees where radians are meant. Each check below is one function of the dataset; its
thresholds are far from what the published demonstrations hold, so that a finding is worth a look.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from pemirl_trl.data.demonstrations import DemonstrationDataset
from pemirl_trl.data.doctor_actions import Bounds, acted, checked_bounds, examine_actions
from pemirl_trl.data.doctor_steps import jumps, mixed_rates, off_by_one, resets
from pemirl_trl.data.findings import CONSTANT, Finding, numbers
from pemirl_trl.data.validation import episode_names

__all__ = ["Finding", "examine", "examine_actions"]

FEWEST_EPISODES = 10
SCALE_RATIO = 1e3
"""Deviations that differ by more from their median are of different worlds."""
OFFSET_RATIO = 1e4
"""float32 has seven digits: beyond this ratio of mean to deviation fewer than three vary."""


def examine(dataset: DemonstrationDataset, action_bounds: Bounds | None = None) -> list[Finding]:
    """Look for what well-formed demonstrations should not hold; errors first.

    Args:
        dataset: the demonstrations.
        action_bounds: lowest and highest action of the environment, numbers or ``[A]``. Policies
            may exceed them, since an environment clips; far outside is suspicious.

    Raises:
        ValueError: the bounds are not of the actions' dimension, the lower is not the lower, or
            actions are discrete and have none.
    """
    discrete = dataset.discrete
    if discrete and action_bounds is not None:
        raise ValueError(
            f"got action_bounds {action_bounds}, but the actions are {dataset.action_dim} choices; "
            "expected None"
        )
    bounds = None
    if dataset.action_dim > 0 and action_bounds is not None:
        bounds = checked_bounds(action_bounds, dataset.action_dim)
    findings = [finding for check in _CHECKS for finding in check(dataset)]
    findings += acted(dataset, bounds)
    return sorted(findings, key=lambda finding: finding.severity != "error")


def _few(dataset: DemonstrationDataset) -> Iterator[Finding]:
    if len(dataset) < FEWEST_EPISODES:
        cure = f"collect at least {FEWEST_EPISODES}; the paper has several of each of 100 tasks"
        yield Finding("warning", "few demonstrations", f"{len(dataset)} in all", cure)


def _unexplained_ends(dataset: DemonstrationDataset) -> Iterator[Finding]:
    short = int(dataset.ended.sum())
    if short and dataset.terminated is None:
        what = "lengths differ, and nobody says whether the short ones ended or were cut"
        where = f"{short} are shorter than {dataset.horizon} steps, and count as ended"
        cure = "say so: from_episodes(..., terminated=True), or False, or one for each"
        yield Finding("warning", what, where, cure)


def _constant(dataset: DemonstrationDataset) -> Iterator[Finding]:
    values_of = {"observation": dataset.observation}
    # Of choices, one that is never taken is no constant to leave out.
    if dataset.action_dim and not dataset.discrete:
        values_of["action"] = dataset.action
    for name, values in values_of.items():
        flat = values.double().flatten(0, 1).std(0, correction=0) <= CONSTANT
        if flat.any():
            cure = "leave it out, unless it varies elsewhere"
            yield Finding("warning", f"{name} is constant", numbers(flat), cure)


def _badly_scaled(dataset: DemonstrationDataset) -> Iterator[Finding]:
    rows = dataset.observation.double().flatten(0, 1)
    deviation = rows.std(0, correction=0)
    varies = deviation > CONSTANT
    if not varies.any():
        return
    ratio = deviation / deviation[varies].median()
    odd = varies & ((ratio > SCALE_RATIO) | (ratio < 1 / SCALE_RATIO))
    if odd.any():
        what = f"observation varies by {SCALE_RATIO:g} times more or less than its median feature"
        cure = "choose units in which features are alike: networks hardly see the smaller ones"
        yield Finding("warning", what, numbers(odd), cure)
    shifted = varies & (rows.mean(0).abs() > OFFSET_RATIO * deviation)
    if shifted.any():
        what = "observation hardly varies beside its mean, which costs digits in float32"
        yield Finding("warning", what, numbers(shifted), "subtract the mean before float32")


def _duplicates(dataset: DemonstrationDataset) -> Iterator[Finding]:
    first: dict[bytes, int] = {}
    repeated = []
    for index, (observation, action) in enumerate(
        zip(dataset.observation, dataset.action, strict=True)
    ):
        content = b"".join(x.contiguous().cpu().numpy().tobytes() for x in (observation, action))
        if first.setdefault(content, index) != index:
            repeated.append(index)
    if repeated:
        where = f"{episode_names(repeated)}, equal to earlier ones"
        yield Finding("warning", "duplicated demonstrations", where, "keep one of each")


_CHECKS: tuple[Callable[[DemonstrationDataset], Iterator[Finding]], ...] = (
    off_by_one,
    resets,
    _few,
    _unexplained_ends,
    _duplicates,
    _constant,
    _badly_scaled,
    jumps,
    mixed_rates,
)
