"""Ids of gymnasium for tasks."""

from __future__ import annotations

from collections.abc import Iterable

import gymnasium

from pemirl_envs.tasks import TASKS

_FACES = __name__.rpartition(".")[0]  # the package that holds GymEnv and GymVectorEnv


def gym_id(name: str) -> str:
    """The gymnasium id of a task: ``point_maze/left`` is ``pemirl_envs/PointMazeLeft-v0``."""
    return f"pemirl_envs/{''.join(part.title() for part in name.replace('/', '_').split('_'))}-v0"


def register_tasks(names: Iterable[str]) -> None:
    """Registers tasks with gymnasium, by their names ``"domain/variant"``, unless they are."""
    for name in names:
        if gym_id(name) not in gymnasium.registry:
            gymnasium.register(
                gym_id(name),
                entry_point=f"{_FACES}:GymEnv",
                vector_entry_point=f"{_FACES}:GymVectorEnv",
                kwargs={"name": name},
            )


def check_ids(names: Iterable[str]) -> None:
    """Checks that new tasks have gymnasium ids of their own, before any is registered.

    Raises:
        ValueError: another task has the id: ``a_b/c`` and ``a/b_c`` would share theirs.
    """
    taken = {gym_id(name): name for name in TASKS}
    for name in names:
        other = taken.setdefault(gym_id(name), name)
        if other != name:
            raise ValueError(
                f"the gymnasium id {gym_id(name)} of {name!r} is taken by {other!r}; choose "
                "another name for the domain or its variant"
            )
