"""What is suspicious about the actions of demonstrations, by themselves or beside their bounds."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from pemirl_trl.data.demonstrations import DemonstrationDataset
from pemirl_trl.data.findings import Finding, numbers
from pemirl_trl.data.lengths import steps_after
from pemirl_trl.data.validation import episode_names

__all__ = ["Bounds", "acted", "checked_bounds", "examine_actions"]

ACTION_RATIO = 10.0
"""A policy begins with one deviation for all components of an action."""
LARGEST_ACTION, SMALLEST_ACTION = 100.0, 1e-4
"""Root mean squares of actions that a policy of unit deviation can imitate."""
OUTSIDE_RMS, OUTSIDE_ONCE, HARDLY_USED = 3.0, 30.0, 1e-3
"""The same, and single actions, in half-widths of the bounds."""

Bounds = tuple[ArrayLike, ArrayLike]
"""The lowest and the highest action, numbers or ``[A]``."""


def examine_actions(dataset: DemonstrationDataset, action_bounds: Bounds) -> list[Finding]:
    """The findings of :func:`examine` about actions beside the bounds of an environment.

    Args:
        dataset: demonstrations with continuous actions.
        action_bounds: as there.

    Raises:
        ValueError: as there.
    """
    return [*_bounded_scale(dataset, *checked_bounds(action_bounds, dataset.action_dim))]


def checked_bounds(bounds: Bounds, dimension: int) -> tuple[Tensor, Tensor]:
    """Lowest and highest actions ``[A]``, or ValueError."""
    low, high = (torch.as_tensor(bound, dtype=torch.float32) for bound in bounds)
    fits = all(bound.shape in ((), (dimension,)) for bound in (low, high))
    if not fits or not bool((low < high).all()):
        raise ValueError(
            f"action_bounds are {bounds}; expected the lowest and the highest action, numbers or "
            f"{dimension} of them each"
        )
    return low.expand(dimension), high.expand(dimension)


def acted(dataset: DemonstrationDataset, bounds: tuple[Tensor, Tensor] | None) -> Iterator[Finding]:
    """The findings about actions of any kind; ``bounds`` ``[A]`` of continuous ones, if known."""
    if dataset.action_dim == 0:
        yield from _no_actions(dataset)
    elif dataset.discrete:
        yield from _unused_choices(dataset)
    else:
        sized = [
            *(_unbounded_scale(dataset) if bounds is None else _bounded_scale(dataset, *bounds))
        ]
        yield from sized or _uneven_actions(dataset)


def _demonstrated(dataset: DemonstrationDataset, values: Tensor) -> Tensor:
    """``[M, T, F]`` without padding, as rows ``[..., F]``."""
    if dataset.length is None:
        return values.flatten(0, 1)
    return values[~steps_after(dataset.length, dataset.horizon)]


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
        yield Finding("warning", f"actions of scale {worst}", numbers(odd), cure)


def _uneven_actions(dataset: DemonstrationDataset) -> Iterator[Finding]:
    """Components of an action of different sizes, such as newtons and newton metres."""
    scale = _demonstrated(dataset, dataset.action).double().square().mean(0).sqrt()
    small = (scale > 0) & (scale < scale.max() / ACTION_RATIO)
    if small.any():
        what = f"actions {ACTION_RATIO:g} times smaller than the largest component"
        cure = "choose units in which components are alike, such as shares of their bounds: a "
        cure += "policy has one deviation for all, in which the smaller ones drown"
        yield Finding("warning", what, numbers(small), cure)


def _bounded_scale(dataset: DemonstrationDataset, low: Tensor, high: Tensor) -> Iterator[Finding]:
    relative = (dataset.action.cpu() - (low + high) / 2) / ((high - low) / 2)  # [M, T, A]
    rows = _demonstrated(dataset, relative)
    scale = rows.double().square().mean(0).sqrt()
    outside = (scale > OUTSIDE_RMS) | (rows.abs().amax(0) > OUTSIDE_ONCE)
    if outside.any():
        episodes = (relative.abs() > OUTSIDE_RMS).any(2).any(1).nonzero().flatten()
        where = f"{numbers(outside)} in {episode_names(episodes)}"
        cure = "check the units of actions and bounds"
        yield Finding("error", "actions far outside their bounds", where, cure)
    unused = (scale < HARDLY_USED) & (scale > 0)
    if unused.any():
        cure = "check the units of actions and bounds"
        yield Finding("warning", "actions that hardly use their bounds", numbers(unused), cure)
