"""Where adaptation may start and how widely it may look, before short tries choose."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.methods.adaptation import AdaptationConfig
from pemirl_trl.methods.defaults import (
    Exploration,
    Values,
    adaptation_config,
    found_for_adaptation,
    table,
)
from pemirl_trl.modules import PEMIRLModel

Start = Literal["fresh", "trained"]


class Candidate(NamedTuple):
    """One way to adapt.

    Attributes:
        start: the policy it begins with.
        exploration: see :data:`pemirl_trl.methods.defaults.Exploration`.
        config: all settings.
        settings: a table of those that were found from the data.
    """

    start: Start
    exploration: Exploration
    config: AdaptationConfig
    settings: str

    @property
    def name(self) -> str:
        """Start and exploration, in words."""
        return f"{self.start}-{self.exploration}"


def candidates(
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    overrides: Values,
    exploration: Exploration | None = None,
) -> list[Candidate]:
    """All ways to adapt that the user has left open.

    Discrete actions are explored widely alone: a share of them is drawn uniformly, and no deviation
    is there to be learned.

    Args:
        model: whose reward it is.
        demonstrations: one of each new task.
        overrides: fields of :class:`AdaptationConfig`; ``initial_policy`` leaves one start.
        exploration: leaves one.

    Raises:
        ValueError: a wrong name or value of a setting, or of the exploration.
    """
    ways: tuple[Exploration, ...] = get_args(Exploration)
    if model.config.actions == "discrete":
        ways = ("wide",)
    if exploration is not None:
        if exploration not in ways:
            raise ValueError(f"unknown exploration {exploration!r}; choose one of {[*ways]}")
        ways = (exploration,)
    given = adaptation_config(model, demonstrations, overrides, ways[0])  # refuses what is wrong
    starts: tuple[Start, ...] = get_args(Start)
    if "initial_policy" in overrides:
        starts = (given.initial_policy,)
    found = []
    for way in ways:
        values = found_for_adaptation(model, demonstrations, overrides, way)
        for start in starts:
            settings: dict[str, Any] = {**overrides, "initial_policy": start}
            config = adaptation_config(model, demonstrations, settings, way)
            found.append(Candidate(start, way, config, table(values, config)))
    return found
