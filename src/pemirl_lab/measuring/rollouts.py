"""Environments of a run, what they are reset to, and whole episodes in them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.envs import EnvBase, Transform, TransformedEnv

import pemirl_envs
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset, InferContext, PEMIRLModel, SampleTasks
from pemirl_trl.evaluation import Actor, whole_episodes

Sampler = Callable[[int], TensorDictBase]
"""Number of tasks -> their parameters."""


def environment(
    name: str, num_envs: int, transform: Transform, *, seed: int, threads: int
) -> EnvBase:
    """A batched task with a transform that decides what is rolled out."""
    base = pemirl_envs.make(name, num_envs, seed=seed, num_threads=threads)
    return TransformedEnv(base, transform)


def given_tasks(tasks: TensorDictBase) -> Sampler:
    """A sampler for :class:`SampleTasks` that always gives these."""
    return lambda count: tasks[:count]


def split_sampler(name: str, split: str) -> Sampler:
    """A sampler for :class:`SampleTasks` that draws from a split of a task."""
    task = pemirl_envs.get_task(name)

    def sample(count: int) -> TensorDictBase:
        drawn = task.sample_parameters(count, split, torch.default_generator)
        return TensorDict(drawn, [count])

    return sample


def of_tasks(tasks: TensorDictBase, episodes: int) -> Transform:
    """Resets to given tasks, so many episodes of each, task-major."""
    return SampleTasks(given_tasks(tasks), rollouts_per_task=episodes)


def of_demonstrations(
    model: PEMIRLModel, demonstrations: DemonstrationDataset, episodes: int
) -> Transform:
    """Writes the mean of q(m | demonstration) of each, and resets to its task where it is known."""
    return InferContext(
        model.encoder,
        demonstrations.trajectories(),
        rollouts_per_context=episodes,
        draw="all",
        sample=False,
        tasks=None if demonstrations.task is None else demonstrations.tasks(),
    )


def evaluation_episodes(
    settings: Settings,
    name: str,
    actor: Actor,
    transform: Transform,
    tasks: int,
    *,
    episodes: int | None = None,
    sample: bool = False,
) -> TensorDictBase:
    """Whole episodes ``[tasks * episodes, T]`` under some dynamics, of the mean action.

    Args:
        settings: give the seed of the environments, and how many episodes of each task.
        name: of the environment.
        actor: acts; None draws actions uniformly.
        transform: :func:`of_tasks` or :func:`of_demonstrations`.
        tasks: how many there are.
        episodes: of each task, where it is not ``settings.evaluation.episodes``.
        sample: whether actions are drawn instead.
    """
    count = tasks * (episodes or settings.evaluation.episodes)
    where = {"seed": settings.evaluation.seed, "threads": settings.threads}
    env = environment(name, count, transform, **where)
    return whole_episodes(env, actor, pemirl_envs.get_task(name).horizon, sample=sample)


def true_reward_module(name: str) -> TensorDictModule:
    """The true reward of ``observation``, ``action`` and the task, as a function.

    Writes ``learned_reward``, as a learned one does.

    Raises:
        ValueError: when it is called: the task's reward is no function of what is observed.
    """
    task = pemirl_envs.get_task(name)
    low, high = task.action_bounds
    key = task.task_key

    def reward(observation: Tensor, action: Tensor, parameter: Tensor) -> Tensor:
        value = task.state_reward(observation, action.clamp(low, high), {key: parameter})
        return value.unsqueeze(-1)

    keys = ["observation", "action", ("task", key)]
    return TensorDictModule(reward, in_keys=keys, out_keys=["learned_reward"])
