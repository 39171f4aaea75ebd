"""Goals in a rectangle of the plane, and the fixed sets of them that a task publishes."""

from __future__ import annotations

import dataclasses

import torch
from torch import Generator, Tensor

_SET_SIZES = {"train_100": 100, "validation": 15, "test": 30, "confirm": 30}


@dataclasses.dataclass(frozen=True)
class GoalBox:
    """The distribution of goals uniform in a rectangle, and finite sets drawn from it once.

    Splits:
        ``train_100``: 100 goals (the paper's number of training tasks).
        ``validation``: 15 other goals, to choose settings on.
        ``test``: 30 other goals, to report on (the paper's number of test tasks).
        ``confirm``: 30 more, to be looked at once, when nothing is left to choose.
        ``uniform``: a new draw for each episode. Covers every other split.

    Attributes:
        low, high: the rectangle's lower left and upper right corner, metres.
        seed: of the finite sets.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    seed: int

    splits = (*_SET_SIZES, "uniform")

    @property
    def bounds(self) -> tuple[Tensor, Tensor]:
        """The rectangle as ``Task.parameter_bounds`` wants it, float32 ``(low [2], high [2])``."""
        low, high = torch.tensor((self.low, self.high), dtype=torch.float32)
        return low, high

    def task_set(self, split: str) -> Tensor:
        """All goals of a finite split, float32 ``[K, 2]``.

        Raises:
            ValueError: the split is unknown, or ``uniform``.
        """
        if split not in _SET_SIZES:
            legal = tuple(_SET_SIZES)
            raise ValueError(f"{split!r} is not a finite split; expected one of {legal}")
        # The sets are consecutive parts of one stream, so no goal can be in two of them.
        every = self._draw(sum(_SET_SIZES.values()), Generator().manual_seed(self.seed))
        parts = every.split(list(_SET_SIZES.values()))
        return dict(zip(_SET_SIZES, parts, strict=True))[split]

    def sample(self, n: int, split: str, generator: Generator) -> Tensor:
        """Draws ``n`` goals from a split, float32 ``[n, 2]``.

        Raises:
            ValueError: there is no such split.
        """
        if split == "uniform":
            return self._draw(n, generator)
        if split not in self.splits:
            raise ValueError(f"unknown split {split!r}; expected one of {self.splits}")
        goals = self.task_set(split)
        return goals[torch.randint(len(goals), (n,), generator=generator)]

    def _draw(self, n: int, generator: Generator) -> Tensor:
        low, high = self.bounds
        unit = torch.rand(n, 2, dtype=torch.float64, generator=generator).float()
        return torch.clamp(low + (high - low) * unit, low, high)  # rounding may step outside
