"""Experts: policies that read the task, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensordict import TensorDictBase

import pemirl_envs
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.settings import ExpertPolicy
from pemirl_trl import ContextPolicy, Standardize
from pemirl_trl.files import load_weights, read_metadata
from pemirl_trl.modules.model import ACTIVATIONS


def new_expert(name: str, sizes: ExpertPolicy) -> ContextPolicy:
    """An untrained policy that reads the task, for the task's sizes.

    Its map of observations is fitted on the reachable box, sampled by random actions.
    """
    rollouts = random_rollouts(name)
    key = pemirl_envs.get_task(name).task_key
    return _policy(
        name,
        sizes,
        Standardize.fit(rollouts["observation"]),
        Standardize.fit(rollouts["task", key][:, 0]) if sizes.standardize_task else None,
    )


def random_rollouts(name: str) -> TensorDictBase:
    """256 episodes of random actions: the reachable box, sampled."""
    env = pemirl_envs.make(name, 256, seed=0)
    return env.rollout(env.task.horizon, break_when_any_done=False)


def expert_facts(environment: str, sizes: ExpertPolicy) -> dict[str, str]:
    """What a file has to say of an expert, so that :func:`load_expert` can rebuild it."""
    return {
        "environment": environment,
        "task_key": pemirl_envs.get_task(environment).task_key,
        "hidden": ",".join(map(str, sizes.hidden)),
        "activation": sizes.activation,
        "standardize_task": str(sizes.standardize_task),
    }


def load_expert(path: str) -> ContextPolicy:
    """The expert of a file that ``pemirl train_expert`` wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds something else.
    """
    file = data_file(path)
    facts = read_metadata(file)
    sizes = _sizes(file, facts)
    name = facts["environment"]
    observations = Standardize.identity(pemirl_envs.get_task(name).observation_size)
    tasks = Standardize.identity(_task_features(name)) if sizes.standardize_task else None
    policy = _policy(name, sizes, observations, tasks)
    load_weights(file, {"policy": policy})
    return policy


def _sizes(file: Any, facts: Mapping[str, str]) -> ExpertPolicy:
    if missing := sorted({"environment", "hidden"} - set(facts)):
        raise ValueError(f"{file} holds no expert: it does not say {', '.join(missing)}")
    return ExpertPolicy(
        hidden=[int(width) for width in facts["hidden"].split(",")],
        activation=facts.get("activation", "relu"),  # type: ignore[arg-type]
        scale=1.0,  # the file's own takes its place, as it does for both maps
        standardize_task=facts.get("standardize_task") == "True",
    )


def _policy(
    name: str,
    sizes: ExpertPolicy,
    standardize: Standardize,
    standardize_task: Standardize | None,
) -> ContextPolicy:
    task = pemirl_envs.get_task(name)
    return ContextPolicy(
        standardize.features,
        len(task.action_bounds[0]),
        _task_features(name),
        hidden=list(sizes.hidden),
        activation=ACTIVATIONS[sizes.activation],
        initial_scale=sizes.scale,
        standardize=standardize,
        standardize_context=standardize_task,
        context_key=("task", task.task_key),
    )


def _task_features(name: str) -> int:
    task = pemirl_envs.get_task(name)
    low, _ = task.parameter_bounds[task.task_key]
    return low.numel()
