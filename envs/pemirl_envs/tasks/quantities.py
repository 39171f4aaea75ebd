"""What a task's numbers mean: components of an observation, and measures of an episode."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

from torch import Tensor

Parameters = Mapping[str, Tensor]
"""What distinguishes one task of a family from another (a goal, a direction), each ``[N, ...]``."""

Outcome = Callable[[Tensor, Parameters], Tensor]
"""(observations ``[N, T, S]``, parameters) -> ``[N]``: what a person would look at."""

Controller = Callable[[Tensor, Parameters], Tensor]
"""(observation ``[N, S]``, parameters) -> action ``[N, A]``, within its bounds."""


@dataclasses.dataclass(frozen=True)
class Component:
    """A named part of an observation.

    Attributes:
        name: of the part, unique within its task.
        unit: of each of its numbers, such as ``"m/s"``; ``"1"`` where they have none.
        size: how many numbers it has.
    """

    name: str
    unit: str
    size: int = 1


def component_slice(components: Sequence[Component], name: str) -> slice:
    """Where a component stands in an observation that is made of ``components``, in order.

    >>> component_slice((Component("hand", "m", 3), Component("mug", "m", 2)), "mug")
    slice(3, 5, None)

    Raises:
        ValueError: none of them has this name; lists those that there are.
    """
    start = 0
    for component in components:
        if component.name == name:
            return slice(start, start + component.size)
        start += component.size
    legal = ", ".join(component.name for component in components)
    raise ValueError(f"unknown component {name!r} of an observation; expected one of {legal}")


def final_distance_to_goal(components: Sequence[Component], name: str) -> Outcome:
    """The horizontal distance of a component (x, y, ...) to the parameter ``goal`` at the end.

    Raises:
        ValueError: there is no such component.
    """
    start = component_slice(components, name).start

    def final_distance(observation: Tensor, parameters: Parameters) -> Tensor:
        return (observation[:, -1, start : start + 2] - parameters["goal"]).norm(dim=-1)

    return final_distance
