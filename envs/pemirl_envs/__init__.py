"""MuJoCo task families for meta inverse RL, with one description and three faces."""

from __future__ import annotations

import os
from typing import Any

# Before mujoco: OSMesa brings an LLVM of its own, and the triton of PyTorch's CUDA build, which
# tensordict imports, crashes when it finds that one.
from tensordict import TensorDict

try:
    import mujoco  # noqa: F401  # before dm_control, for the sake of the message
except (AttributeError, ImportError, RuntimeError) as error:
    raise ImportError(
        f"MuJoCo could not be imported with MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}. Where its "
        "OpenGL library is missing, install it (Debian: apt-get install --no-install-recommends "
        "libosmesa6, with MUJOCO_GL=osmesa), or set MUJOCO_GL=disable to go without rendering"
    ) from error

from dm_control.rl.control import Environment

from pemirl_envs.control import load as _load_task
from pemirl_envs.gym import check_ids, register_tasks
from pemirl_envs.simulation import Fields, Seed, SimulationError, State
from pemirl_envs.tasks import (
    TASKS,
    Component,
    Controller,
    Layout,
    Outcome,
    Parameters,
    SeveralBodies,
    Task,
    Variants,
    get_task,
    register,
)
from pemirl_envs.torchrl import TaskEnv


def make(
    name: str,
    num_envs: int = 1,
    *,
    split: str | None = None,
    seed: Seed = None,
    num_threads: int | None = None,
) -> TaskEnv:
    """Makes the TorchRL face of a task: see :class:`TaskEnv`.

    Raises:
        TypeError: what is given as a seed is none.
        ValueError: unknown task or split, or a count that is not positive.
    """
    return TaskEnv(get_task(name), num_envs, split=split, seed=seed, num_threads=num_threads)


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: dict[str, Any] | None = None,
    environment_kwargs: dict[str, Any] | None = None,
    visualize_reward: bool = False,
) -> Environment:
    """Loads the dm_control face of a task, with the arguments of ``dm_control.suite.load``.

    Args:
        domain_name: the domain, such as ``"point_maze"``.
        task_name: the variant, such as ``"left"``.
        task_kwargs: ``random`` (a seed, as for ``make``), ``split``, ``time_limit`` in seconds,
            and ``parameters``, which fixes the task of every episode: ``{"goal": (0.3, 0.5)}``.
        environment_kwargs: keywords of ``control.Environment``, such as ``flat_observation``.
        visualize_reward: accepted for compatibility, without effect: dm_control highlights rewards
            in (0, 1], and these are not scaled to that range.

    Raises:
        ValueError: unknown domain, task or split, or illegal parameters.
    """
    del visualize_reward
    task = get_task(f"{domain_name}/{task_name}")
    return _load_task(task, **(task_kwargs or {}), environment_kwargs=environment_kwargs)


def task_parameters(name: str, split: str) -> TensorDict:
    """The parameters of all ``K`` tasks of a finite split, batch size ``[K]``.

    >>> task_parameters("point_maze/left", "test")["goal"].shape
    torch.Size([30, 2])

    Raises:
        ValueError: unknown task or split, or a split that is a distribution.
    """
    parameters = get_task(name).task_set(split)
    size = len(next(iter(parameters.values())))
    return TensorDict(parameters, batch_size=[size])


def layout(name: str) -> Layout:
    """The plan (walls, start, bounds) of a planar task.

    Raises:
        ValueError: unknown task, or one that is not planar.
    """
    return get_task(name).layout()


def register_domain(domain: str, variants: Variants) -> None:
    """Makes tasks from outside of this package known to every face, in this process.

    ``register_domain("my_domain", {"normal": MyTask})`` makes ``"my_domain/normal"`` a name for
    ``make`` and ``get_task``, ``("my_domain", "normal")`` for ``load``, and
    ``"pemirl_envs/MyDomainNormal-v0"`` an id of Gymnasium.

    Args:
        domain: its name, ``lower_case``.
        variants: by name, functions without arguments (such as a class) that make a :class:`Task`.

    Raises:
        ValueError: a name is malformed or taken, or there are no variants.
        TypeError: a variant is not a function that makes a task.
    """
    names = [f"{domain}/{variant}" for variant in variants]
    check_ids(names)
    register(domain, variants)
    register_tasks(names)


register_tasks(TASKS)

__all__ = [
    "TASKS",
    "Component",
    "Controller",
    "Fields",
    "Layout",
    "Outcome",
    "Parameters",
    "Seed",
    "SeveralBodies",
    "SimulationError",
    "State",
    "Task",
    "TaskEnv",
    "Variants",
    "get_task",
    "layout",
    "load",
    "make",
    "register_domain",
    "task_parameters",
]
