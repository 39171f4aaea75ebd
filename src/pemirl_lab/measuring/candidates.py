"""Rewards to be measured: of a model, of a file, or any function that somebody has written."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pemirl_lab.runs.own_task import load_function
from pemirl_trl import DemonstrationDataset, PEMIRLModel, PortableReward, load_reward
from pemirl_trl.evaluation import RewardFunction, shaped_reward_of, state_reward_of
from pemirl_trl.files import Card

Numbers = Literal["torch", "numpy"]


@dataclass(frozen=True)
class Candidate:
    """A reward to be measured, and what it reads.

    Attributes:
        name: for the page.
        rewards: by the names that the report gives them; of transitions that carry a ``context``.
        context: ``[C, D]``, of each of C tasks.
        context_is: what that is, in words.
        gamma: discount of the shaping that distances do not see.
        card: where it is from, where it says.
    """

    name: str
    rewards: Mapping[str, RewardFunction]
    context: Tensor
    context_is: str
    gamma: float
    card: Card | None = None


@torch.no_grad()
def of_model(
    model: PEMIRLModel | PortableReward,
    demonstrations: DemonstrationDataset,
    name: str = "model",
) -> Candidate:
    """R and f of a model or of a reward that was shared, m inferred from one demonstration each."""
    return Candidate(
        name=name,
        rewards={"r": state_reward_of(model.reward), "f": shaped_reward_of(model.reward)},
        context=model.encoder.get_dist(demonstrations.trajectories()).mean,
        context_is="the mean of q(m | the task's one demonstration)",
        gamma=model.reward.gamma,
        card=getattr(model, "card", None),
    )


def of_name(
    name: str,
    demonstrations: DemonstrationDataset,
    *,
    encoder_file: str | None,
    numbers: Numbers,
    gamma: float,
) -> Candidate:
    """What ``reward=`` names: ``module:function``, or the file or the zoo's name of a reward.

    Args:
        name: as it was given.
        demonstrations: one of each task, with the tasks.
        encoder_file: of a function: a reward whose q says what m is; None: m is what the task is,
            its parameters side by side.
        numbers: of a function: whether it takes tensors or NumPy arrays.
        gamma: of a function: discount of the shaping that distances do not see.

    Raises:
        FileNotFoundError, ValueError: there is no such thing, or it is no such function.
    """
    if ":" not in name:
        if encoder_file is not None:
            raise ValueError(f"reward={name} has its own encoder; got encoder_file={encoder_file}")
        return of_model(load_reward(name), demonstrations, name)
    function = on_rows(load_function(name, "reward"), f"reward={name}", numbers)

    def reward(transitions: TensorDictBase) -> Tensor:
        return function(transitions["observation"], transitions["context"])

    if encoder_file is None:
        context, context_is = task_parameters(demonstrations), "the task itself: its parameters"
    else:
        inferred = of_model(load_reward(encoder_file), demonstrations)
        context, context_is = inferred.context, f"{inferred.context_is}, by {encoder_file}"
    return Candidate(name, {"r": reward}, context, context_is, gamma)


def on_rows(
    function: Callable[..., Any], name: str, numbers: Numbers
) -> Callable[[Tensor, Tensor], Tensor]:
    """A function of rows ``[n, S]`` and ``[n, D]``, on batches of any size.

    It may take the observation alone, the observation and m, or a third argument ``info``, as
    ``compute_reward(achieved_goal, desired_goal, info)`` of Gymnasium-Robotics does.

    Raises:
        ValueError: it takes something else; or, when it is called, it does not give a number each.
    """
    arguments = list(inspect.signature(function).parameters.values())
    required = [a.name for a in arguments if a.default is a.empty and a.kind is not a.VAR_KEYWORD]
    infos: list[dict[str, Any]] = [{}] if len(required) == 3 and required[2] == "info" else []
    if len(required) - len(infos) not in (1, 2):
        raise ValueError(
            f"{name} takes ({', '.join(required)}); expected (observation), (observation, m)"
            " or (observation, m, info)"
        )

    def on_batch(observation: Tensor, context: Tensor) -> Tensor:
        rows = [x.reshape(-1, x.shape[-1]) for x in (observation, context)]
        given: list[Any] = [x.numpy() for x in rows] if numbers == "numpy" else list(rows)
        values = torch.as_tensor(function(*given[: len(required) - len(infos)], *infos))
        count = len(rows[0])
        if values.shape not in ((count,), (count, 1)):
            raise ValueError(
                f"{name} gave {list(values.shape)} for {count} observations; expected "
                f"[{count}] or [{count}, 1], a number each"
            )
        return values.reshape(observation.shape[:-1])

    return on_batch


def task_parameters(demonstrations: DemonstrationDataset) -> Tensor:
    """What the tasks are ``[C, D]``: their parameters side by side, in the order of their names.

    Raises:
        ValueError: the demonstrations do not say.
    """
    tasks = demonstrations.tasks()
    names = sorted(tasks.keys())
    return torch.cat([tasks[name].reshape(len(demonstrations), -1) for name in names], -1)
