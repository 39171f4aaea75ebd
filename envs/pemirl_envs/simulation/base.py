"""What a task may ask of an engine, and the error of an engine that could not oblige."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

Fields = Callable[[str], Tensor]
"""``fields(name)``: a named engine field of every simulation, float64 ``[N, ...]``. Read-only."""

State = Mapping[str, Tensor]
"""Values to write into named state fields, each ``[N, ...]``."""

_SHOWN = 5  # simulations that an error message spells out


class Simulation(Protocol):
    """``N`` simulations of one model, advanced together."""

    @property
    def num_sims(self) -> int:
        """The number of simulations, ``N``."""

    def field(self, name: str) -> Tensor:
        """The current values of a named field, ``[N, ...]``: a live view; read, do not keep."""

    def write(self, state: State, mask: Tensor | None = None, *, refresh: bool = True) -> None:
        """Writes state fields of the simulations in ``mask`` (bool ``[N]``; ``None``: all).

        Without ``refresh``, derived fields keep their values until the next step.
        """

    def step(self, n_sub_steps: int, mask: Tensor | None = None) -> dict[int, str]:
        """Advances the simulations in ``mask`` by ``n_sub_steps`` physics steps.

        Returns:
            Why each simulation that failed did so, by index; empty when all went well. A failed
            simulation keeps the state that it had before the call, and the others advance.
        """

    def reset(self, mask: Tensor | None = None) -> None:
        """Puts the simulations in ``mask`` into the model's default state."""


class SimulationError(RuntimeError):
    """Some simulations of a step failed; the others advanced, and their results are kept.

    A failed simulation keeps the state that it had before the step. To go on, act on it again or
    reset it alone.

    Attributes:
        reasons: why each failed simulation did so, by index.
        indices: the failed simulations, int64 ``[F]``, sorted.
        partial: what the step would have returned. Rows of failed simulations hold the observation
            from before the step, a NaN reward, and done flags that are False.
    """

    def __init__(self, reasons: Mapping[int, str], partial: Any = None) -> None:
        self.reasons = dict(sorted(reasons.items()))
        self.indices = torch.tensor(list(self.reasons), dtype=torch.int64)
        self.partial = partial
        shown = [f"{i}: {reason}" for i, reason in list(self.reasons.items())[:_SHOWN]]
        if len(self.reasons) > _SHOWN:
            shown.append("...")
        super().__init__(f"{len(self.reasons)} simulation(s) failed ({'; '.join(shown)})")
