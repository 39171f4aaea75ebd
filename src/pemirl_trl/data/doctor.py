"""What is suspicious about demonstrations that are well formed, and what to do about it.

A well-formed dataset can still be one that nobody can learn from: two episodes glued together,
actions in degrees where radians are meant. Each check below is one function of the dataset; its
thresholds are far from what the published demonstrations hold, so that a finding is worth a look.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from pemirl_trl.data.demonstrations import DemonstrationDataset
from pemirl_trl.data.lengths import steps_after
from pemirl_trl.data.validation import episode_names

__all__ = ["Finding", "examine", "examine_actions"]

Severity = Literal["warning", "error"]

FEWEST_EPISODES = 10
CONSTANT = 1e-6
"""A feature of no more deviation counts as constant, as in pemirl_trl.modules.Standardize."""
SCALE_RATIO = 1e3
"""Deviations that differ by more from their median are of different worlds."""
ACTION_RATIO = 10.0
"""A policy begins with one deviation for all components of an action."""
OFFSET_RATIO = 1e4
"""float32 has seven digits: beyond this ratio of mean to deviation fewer than three vary."""
LARGEST_ACTION, SMALLEST_ACTION = 100.0, 1e-4
"""Root mean squares of actions that a policy of unit deviation can imitate."""
OUTSIDE_RMS, OUTSIDE_ONCE, HARDLY_USED = 3.0, 30.0, 1e-3
"""The same, and single actions, in half-widths of the bounds."""
JUMP, RESET_STEP = 20.0, 3.0
"""Steps, relative to the 95th percentile of those that are not zero."""
RATE_GAP, RATE_SPREAD, RATE_EPISODES = 1.4, 3.0, 10
"""Two groups of episodes whose step sizes differ by this factor, with no episode in between, and by
so many deviations within a group: goals at various distances make various speeds too."""


@dataclass(frozen=True)
class Finding:
    """One thing that is suspicious.

    Attributes:
        severity: ``"error"`` if learning from this makes no sense, ``"warning"`` if it may.
        what: what was found.
        where: the episodes or features.
        cure: what to do.
    """

    severity: Severity
    what: str
    where: str
    cure: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.what} ({self.where}); {self.cure}"


Bounds = tuple[ArrayLike, ArrayLike]


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
    acted, bounds = dataset.action_dim > 0, None
    if acted and action_bounds is not None:
        bounds = _checked_bounds(action_bounds, dataset.action_dim)
    findings = [finding for check in _CHECKS for finding in check(dataset)]
    if not acted:
        findings += _no_actions(dataset)
    elif discrete:
        findings += _unused_choices(dataset)
    else:
        sized = [
            *(_unbounded_scale(dataset) if bounds is None else _bounded_scale(dataset, *bounds))
        ]
        findings += sized or _uneven_actions(dataset)
    return sorted(findings, key=lambda finding: finding.severity != "error")


def examine_actions(dataset: DemonstrationDataset, action_bounds: Bounds) -> list[Finding]:
    """The findings of :func:`examine` about actions beside the bounds of an environment.

    Args:
        dataset: demonstrations with continuous actions.
        action_bounds: as there.

    Raises:
        ValueError: as there.
    """
    return [*_bounded_scale(dataset, *_checked_bounds(action_bounds, dataset.action_dim))]


def _checked_bounds(bounds: Bounds, dimension: int) -> tuple[Tensor, Tensor]:
    low, high = (torch.as_tensor(bound, dtype=torch.float32) for bound in bounds)
    fits = all(bound.shape in ((), (dimension,)) for bound in (low, high))
    if not fits or not bool((low < high).all()):
        raise ValueError(
            f"action_bounds are {bounds}; expected the lowest and the highest action, numbers or "
            f"{dimension} of them each"
        )
    return low.expand(dimension), high.expand(dimension)


def _numbers(chosen: Tensor) -> str:
    """``feature 3`` or ``features 0, 3`` where ``chosen`` ``[F]`` is true."""
    return episode_names(chosen.nonzero().flatten()).replace("episode", "feature")


def _typical(steps: Tensor) -> Tensor:
    """95th percentile ``[F]`` of the steps ``[M, T, F]`` that are not zero; infinity if all are."""
    values = []
    for column in steps.flatten(0, 1).unbind(-1):
        moving = column[column > 0]
        values.append(
            moving.kthvalue(1 + int(0.95 * (len(moving) - 1))).values
            if len(moving)
            else column.new_tensor(torch.inf)
        )
    return torch.stack(values)


def _varying(dataset: DemonstrationDataset) -> Tensor:
    """Observations ``[M, T+1, F]`` of the features that vary, in deviations."""
    deviation = dataset.observation.double().flatten(0, 1).std(0, correction=0)
    varies = deviation > CONSTANT
    return dataset.observation.double()[..., varies] / deviation[varies]


def _demonstrated(dataset: DemonstrationDataset, values: Tensor) -> Tensor:
    """``[M, T, F]`` without padding, as rows ``[..., F]``."""
    if dataset.length is None:
        return values.flatten(0, 1)
    return values[~steps_after(dataset.length, dataset.horizon)]


# --- checks ------------------------------------------------------------------------------------


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
            yield Finding("warning", f"{name} is constant", _numbers(flat), cure)


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
        yield Finding("warning", what, _numbers(odd), cure)
    shifted = varies & (rows.mean(0).abs() > OFFSET_RATIO * deviation)
    if shifted.any():
        what = "observation hardly varies beside its mean, which costs digits in float32"
        yield Finding("warning", what, _numbers(shifted), "subtract the mean before float32")


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


def _off_by_one(dataset: DemonstrationDataset) -> Iterator[Finding]:
    """Padding at an end of every episode, where the step beside it is none."""
    still = (dataset.observation.diff(dim=1) == 0).all(-1)  # [M, T]
    idle = (dataset.action == 0).all(-1)  # [M, T]
    last = dataset.lengths - 1
    if int(last.min()) < 2:
        return
    first = torch.zeros_like(last)
    rows = torch.arange(len(last), device=last.device)
    for pattern, what in ((idle, "action is all zero"), (still, "step changes nothing")):
        for end, beside, name in ((last, last - 1, "last"), (first, first + 1, "first")):
            if pattern[rows, end].all() and pattern[rows, beside].double().mean() < 0.5:
                yield Finding(
                    "error",
                    f"the {name} {what}, as if padded or misaligned by one",
                    "every episode",
                    "pair each action with the observation it was chosen at, and cut the padding",
                )


def _resets(dataset: DemonstrationDataset) -> Iterator[Finding]:
    """Large steps from outside the box of initial observations to its inside."""
    observation = _varying(dataset)
    if not observation.numel():
        return
    start = observation[:, 0]
    margin = 0.05  # deviations
    inside = (
        (observation >= start.amin(0) - margin) & (observation <= start.amax(0) + margin)
    ).all(-1)  # [M, T+1]
    steps = observation.diff(dim=1).abs()
    large = (steps > RESET_STEP * _typical(steps)).any(-1)  # [M, T]
    reset = large & ~inside[:, :-1] & inside[:, 1:]
    if reset.any():
        episodes = reset.any(1).nonzero().flatten()
        first = int(reset[episodes[0]].nonzero()[0])
        where = f"{episode_names(episodes)}; in episode {int(episodes[0])} after step {first}"
        yield Finding("error", "reset inside an episode", where, "cut the episodes there")


def _jumps(dataset: DemonstrationDataset) -> Iterator[Finding]:
    steps = dataset.observation.double().diff(dim=1).abs()  # [M, T, S]
    jump = steps > JUMP * _typical(steps)
    if jump.any():
        episodes = jump.any(2).any(1).nonzero().flatten()
        where = f"{_numbers(jump.any(0).any(0))} in {episode_names(episodes)}"
        cure = "look for lost or glued recordings, outliers, and angles that wrap around"
        yield Finding("warning", f"a step more than {JUMP:g} times the usual", where, cure)


def _mixed_rates(dataset: DemonstrationDataset) -> Iterator[Finding]:
    if len(dataset) < RATE_EPISODES:
        return
    squares = _varying(dataset).diff(dim=1).square().mean(2).sum(1)  # padding does not move
    steps = (squares / dataset.lengths).sqrt()  # [M]
    ordered, order = steps.clamp(min=1e-12).log().sort()
    gaps = ordered.diff()[1:-1]  # two episodes at least on either side
    gap, split = float(gaps.max()), int(gaps.argmax()) + 2
    groups = (ordered[:split], ordered[split:])
    spread = torch.cat([group - group.mean() for group in groups]).std()
    if gap > max(math.log(RATE_GAP), RATE_SPREAD * float(spread)):
        fewer = order[:split] if split <= len(order) // 2 else order[split:]
        yield Finding(
            "warning",
            f"two groups of episodes, whose steps differ by a factor of {math.exp(gap):.2g} or "
            "more, as if sampled at different rates",
            f"the smaller group: {episode_names(fewer.sort().values)}",
            "resample to one rate",
        )


def _no_actions(dataset: DemonstrationDataset) -> Iterator[Finding]:
    what, where = "no actions were recorded", "every episode"
    cure = (
        "infer and adapt take them, of a model whose encoder reads states alone "
        "(model.encoder_reads=states); meta-training needs actions"
    )
    yield Finding("warning", what, where, cure)


def _unused_choices(dataset: DemonstrationDataset) -> Iterator[Finding]:
    """Discrete actions that nobody takes."""
    taken = dataset.action.sum((0, 1)) > 0
    if not taken.all():
        unused = [i for i, used in enumerate(taken.tolist()) if not used]
        cure = "check the number of actions and the order in which they are counted"
        yield Finding("warning", "discrete actions that are never taken", f"{unused}", cure)


def _unbounded_scale(dataset: DemonstrationDataset) -> Iterator[Finding]:
    scale = _demonstrated(dataset, dataset.action).double().square().mean(0).sqrt()
    odd = (scale > LARGEST_ACTION) | ((scale < SMALLEST_ACTION) & (scale > 0))
    if odd.any():
        worst = ", ".join(f"{float(s):.2g}" for s in scale[odd][:5])
        cure = "divide actions by their bounds: policies start with a deviation near 1"
        yield Finding("warning", f"actions of scale {worst}", _numbers(odd), cure)


def _uneven_actions(dataset: DemonstrationDataset) -> Iterator[Finding]:
    """Components of an action of different sizes, such as newtons and newton metres."""
    scale = _demonstrated(dataset, dataset.action).double().square().mean(0).sqrt()
    small = (scale > 0) & (scale < scale.max() / ACTION_RATIO)
    if small.any():
        what = f"actions {ACTION_RATIO:g} times smaller than the largest component"
        cure = "choose units in which components are alike, such as shares of their bounds: a "
        cure += "policy has one deviation for all, in which the smaller ones drown"
        yield Finding("warning", what, _numbers(small), cure)


def _bounded_scale(dataset: DemonstrationDataset, low: Tensor, high: Tensor) -> Iterator[Finding]:
    relative = (dataset.action.cpu() - (low + high) / 2) / ((high - low) / 2)  # [M, T, A]
    rows = _demonstrated(dataset, relative)
    scale = rows.double().square().mean(0).sqrt()
    outside = (scale > OUTSIDE_RMS) | (rows.abs().amax(0) > OUTSIDE_ONCE)
    if outside.any():
        episodes = (relative.abs() > OUTSIDE_RMS).any(2).any(1).nonzero().flatten()
        where = f"{_numbers(outside)} in {episode_names(episodes)}"
        cure = "check the units of actions and bounds"
        yield Finding("error", "actions far outside their bounds", where, cure)
    unused = (scale < HARDLY_USED) & (scale > 0)
    if unused.any():
        cure = "check the units of actions and bounds"
        yield Finding("warning", "actions that hardly use their bounds", _numbers(unused), cure)


_CHECKS: tuple[Callable[[DemonstrationDataset], Iterator[Finding]], ...] = (
    _off_by_one,
    _resets,
    _few,
    _unexplained_ends,
    _duplicates,
    _constant,
    _badly_scaled,
    _jumps,
    _mixed_rates,
)
