"""The tasks of every domain: one module beside one model file, and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pemirl_envs.tasks import ant, point_maze, sawyer_pusher, sweeper
from pemirl_envs.tasks.base import Layout, Parameters, Task

DOMAINS: dict[str, Mapping[str, Callable[[], Task]]] = {
    "point_maze": point_maze.VARIANTS,
    "ant": ant.VARIANTS,
    "sawyer_pusher": sawyer_pusher.VARIANTS,
    "sweeper": sweeper.VARIANTS,
}

TASKS: dict[str, Callable[[], Task]] = {
    f"{domain}/{variant}": build
    for domain, variants in DOMAINS.items()
    for variant, build in variants.items()
}
"""Every task by name, ``"domain/variant"``."""


def get_task(name: str) -> Task:
    """The task of a name such as ``"point_maze/left"``.

    Raises:
        ValueError: there is no such task.
    """
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}; expected one of {', '.join(TASKS)}")
    return TASKS[name]()


__all__ = ["DOMAINS", "TASKS", "Layout", "Parameters", "Task", "get_task"]
