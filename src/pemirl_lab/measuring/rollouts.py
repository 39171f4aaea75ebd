"""Environments and demonstrations of a recipe, by the names in its configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.envs import (
    EnvBase,
    ExplorationType,
    Transform,
    TransformedEnv,
    set_exploration_type,
)

import pemirl_envs
from pemirl_trl import (
    ContextPolicy,
    DemonstrationDataset,
    InferContext,
    PEMIRLModel,
    SampleTasks,
    Standardize,
)
from pemirl_trl.evaluation import episode_returns
from pemirl_trl.files import load_weights, read_metadata
from pemirl_trl.modules.model import ACTIVATIONS

Actor = Callable[[TensorDictBase], TensorDictBase] | None
"""Writes an action; None draws them uniformly."""
ROOT = Path(__file__).resolve().parent.parent


def data_file(name: str) -> Path:
    """A path as given, or, if there is no such file, the same below the repository's root.

    Raises:
        FileNotFoundError: there is neither.
    """
    for candidate in (Path(name), ROOT / name):
        if candidate.is_file():
            return candidate
    raise FileNotFoundError(f"no file {name}, neither from here nor from {ROOT}")


def run_file(name: str | Path, written_by: str) -> Path:
    """A file of an earlier run, from the working directory alone: that is where runs write.

    Raises:
        FileNotFoundError: it is not there; says which recipe writes it.
    """
    path = Path(name)
    if not path.is_file():
        raise FileNotFoundError(f"no file {path.absolute()}: {written_by} writes it")
    return path


def environment(
    name: str, num_envs: int, transform: Transform, *, seed: int, threads: int
) -> EnvBase:
    """A batched task with a transform that decides what is rolled out."""
    base = pemirl_envs.make(name, num_envs, seed=seed, num_threads=threads)
    return TransformedEnv(base, transform)


def given_tasks(tasks: TensorDictBase) -> Callable[[int], TensorDictBase]:
    """A sampler for :class:`SampleTasks` that always gives these."""
    return lambda count: tasks[:count]


def split_sampler(name: str, split: str) -> Callable[[int], TensorDictBase]:
    """A sampler for :class:`SampleTasks` that draws from a split of a task."""
    task = pemirl_envs.get_task(name)

    def sample(count: int) -> TensorDictBase:
        drawn = task.sample_parameters(count, split, torch.default_generator)
        return TensorDict(drawn, [count])

    return sample


def expert_policy(name: str, task_key: str, sizes: Mapping[str, Any]) -> ContextPolicy:
    """An untrained policy that reads the task, for the task's sizes.

    Its map of observations is fitted on the reachable box, sampled by random actions.

    Args:
        name: of the environment.
        task_key: the task parameter that it reads.
        sizes: ``hidden`` (widths), ``activation``, ``scale`` (the deviation before training) and
            ``standardize_task`` (whether it reads the task in deviations over the default split).
    """
    rollouts = random_rollouts(name)
    parameters = rollouts["task", task_key][:, 0]
    return _expert_policy(
        name,
        task_key,
        sizes,
        Standardize.fit(rollouts["observation"]),
        Standardize.fit(parameters) if sizes["standardize_task"] else None,
    )


def random_rollouts(name: str) -> TensorDictBase:
    """256 episodes of random actions: the reachable box, sampled."""
    env = pemirl_envs.make(name, 256, seed=0)
    return env.rollout(env.task.horizon, break_when_any_done=False)


def _expert_policy(
    name: str,
    task_key: str,
    sizes: Mapping[str, Any],
    standardize: Standardize,
    standardize_task: Standardize | None,
) -> ContextPolicy:
    return ContextPolicy(
        standardize.features,
        len(pemirl_envs.get_task(name).action_bounds[0]),
        _task_features(name, task_key),
        hidden=list(sizes["hidden"]),
        activation=ACTIVATIONS[sizes["activation"]],
        initial_scale=sizes["scale"],
        standardize=standardize,
        standardize_context=standardize_task,
        context_key=("task", task_key),
    )


def _task_features(name: str, task_key: str) -> int:
    low, _ = pemirl_envs.get_task(name).parameter_bounds[task_key]
    return low.numel()


def load_expert(path: str) -> ContextPolicy:
    """The expert of a file that ``train_expert.py`` wrote."""
    file = data_file(path)
    facts = read_metadata(file)
    sizes = {
        "hidden": [int(width) for width in facts["hidden"].split(",")],
        "activation": facts.get("activation", "relu"),
        "scale": 1.0,  # the file's own takes its place, as it does for both maps
    }
    name, key = facts["environment"], facts["task_key"]
    observations = Standardize.identity(pemirl_envs.get_task(name).observation_size)
    tasks = None
    if facts.get("standardize_task") == "True":
        tasks = Standardize.identity(_task_features(name, key))
    policy = _expert_policy(name, key, sizes, observations, tasks)
    load_weights(file, {"policy": policy})
    return policy


def true_reward_module(name: str, task_key: str) -> TensorDictModule:
    """The reward of a planar task, of ``observation``, ``action`` and ``("task", task_key)``.

    Writes ``learned_reward``, as a learned one does. It is the task's own function of its engine's
    fields, of which it reads the position alone: the observation, measured from the start.
    """
    task = pemirl_envs.get_task(name)
    start = torch.tensor(task.layout().start, dtype=torch.float64)
    low, high = task.action_bounds

    def reward(observation: Tensor, action: Tensor, parameter: Tensor) -> Tensor:
        rows = [value.flatten(0, -2) for value in (observation, action, parameter)]
        fields = {"qpos": rows[0].double() - start}
        value = task.reward(fields.__getitem__, rows[1].clamp(low, high), {task_key: rows[2]})
        return value.view(*observation.shape[:-1], 1)

    keys = ["observation", "action", ("task", task_key)]
    return TensorDictModule(reward, in_keys=keys, out_keys=["learned_reward"])


def one_per_task(demonstrations: DemonstrationDataset, per_task: int) -> DemonstrationDataset:
    """The first demonstration of each task, of a set that holds ``per_task`` of each in a row."""
    return demonstrations[::per_task]


def returns_given_tasks(
    name: str, policy: ContextPolicy, tasks: TensorDictBase, config: DictConfig
) -> torch.Tensor:
    """True returns ``[tasks]`` of a policy that reads the task (an expert)."""
    return _returns(name, policy, tasks, _given(tasks, config), config)


def returns_of_random_actions(name: str, tasks: TensorDictBase, config: DictConfig) -> torch.Tensor:
    """True returns ``[tasks]`` of actions drawn uniformly within their bounds."""
    return _returns(name, None, tasks, _given(tasks, config), config)


def returns_given_demonstrations(
    name: str,
    model: PEMIRLModel,
    policy: ContextPolicy,
    demonstrations: DemonstrationDataset,
    config: DictConfig,
) -> torch.Tensor:
    """True returns ``[demonstrations]`` of a policy that reads the mean of q(m | demonstration)."""
    transform = InferContext(
        model.encoder,
        demonstrations.trajectories(),
        rollouts_per_context=config.evaluation.episodes,
        draw="all",
        sample=False,
        tasks=demonstrations.tasks(),
    )
    return _returns(name, policy, demonstrations.tasks(), transform, config)


@torch.no_grad()
def rollouts_given_tasks(
    name: str, actor: Actor, tasks: TensorDictBase, config: DictConfig
) -> TensorDictBase:
    """Whole episodes of mean actions, ``evaluation.episodes`` of each task, task-major."""
    count = len(tasks) * config.evaluation.episodes
    settings = {"seed": config.evaluation.seed, "threads": config.threads}
    env = environment(name, count, _given(tasks, config), **settings)
    horizon = pemirl_envs.get_task(name).horizon
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return env.rollout(horizon, actor, break_when_any_done=False)


def _given(tasks: TensorDictBase, config: DictConfig) -> SampleTasks:
    return SampleTasks(given_tasks(tasks), rollouts_per_task=config.evaluation.episodes)


def _returns(
    name: str,
    policy: ContextPolicy | None,
    tasks: TensorDictBase,
    transform: Transform,
    config: DictConfig,
) -> torch.Tensor:
    episodes = config.evaluation.episodes
    env = environment(
        name,
        tasks.batch_size[0] * episodes,
        transform,
        seed=config.evaluation.seed,
        threads=config.threads,
    )
    horizon = pemirl_envs.get_task(name).horizon
    return episode_returns(env, policy, horizon, episodes_per_task=episodes)
