"""What is suspicious about demonstrations in time: ends, resets, jumps and rates."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from pemirl_trl.data.demonstrations import DemonstrationDataset
from pemirl_trl.data.findings import CONSTANT, Finding, numbers
from pemirl_trl.data.validation import episode_names

__all__ = ["jumps", "mixed_rates", "off_by_one", "resets"]

JUMP, RESET_STEP = 20.0, 3.0
"""Steps, relative to the 95th percentile of those that are not zero."""
RATE_GAP, RATE_SPREAD, RATE_EPISODES = 1.4, 3.0, 10
"""Two groups of episodes whose step sizes differ by this factor, with no episode in between, and by
so many deviations within a group: goals at various distances make various speeds too."""


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


def off_by_one(dataset: DemonstrationDataset) -> Iterator[Finding]:
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


def resets(dataset: DemonstrationDataset) -> Iterator[Finding]:
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


def jumps(dataset: DemonstrationDataset) -> Iterator[Finding]:
    """Steps far beyond the usual ones."""
    steps = dataset.observation.double().diff(dim=1).abs()  # [M, T, S]
    jump = steps > JUMP * _typical(steps)
    if jump.any():
        episodes = jump.any(2).any(1).nonzero().flatten()
        where = f"{numbers(jump.any(0).any(0))} in {episode_names(episodes)}"
        cure = "look for lost or glued recordings, outliers, and angles that wrap around"
        yield Finding("warning", f"a step more than {JUMP:g} times the usual", where, cure)


def mixed_rates(dataset: DemonstrationDataset) -> Iterator[Finding]:
    """Two groups of episodes, as if they were sampled at different rates."""
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
