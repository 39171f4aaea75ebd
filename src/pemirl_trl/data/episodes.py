"""What makes episodes of what people have: arrays, batches of rollouts, flags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch import Tensor

from pemirl_trl.data.conversion import plain_tensor, task_batch
from pemirl_trl.data.entries import action_vectors, observation_vectors

__all__ = ["check_constant", "first_episodes", "flags_of", "pair_of", "task_of"]


def first_episodes(rollouts: TensorDictBase) -> tuple[Tensor, Tensor]:
    """The length of the first episode of each row, ``[M]``, and whether it ended by itself."""
    if rollouts.get("absorbing", None) is not None:
        raise ValueError(
            "these rollouts go on in absorbing states: collect demonstrations from the environment "
            "itself, without AbsorbingState"
        )
    rows, horizon = rollouts.shape
    done, terminated = (
        torch.zeros(rows, horizon, dtype=torch.bool) if flag is None else flag.view(rows, horizon)
        for flag in (rollouts.get(("next", name), None) for name in ("done", "terminated"))
    )
    last = torch.where(done.any(1), done.int().argmax(1), horizon - 1)
    return last + 1, terminated[torch.arange(rows), last]


def check_constant(what: str, later: Tensor, earlier: Tensor, inside: Tensor) -> None:
    """Raise unless ``[M, T-1, ...]`` are equal wherever ``inside`` ``[M, T-1]``."""
    differ = (later != earlier).reshape(*inside.shape, -1).any(-1) & inside
    bad = differ.any(1).nonzero().flatten().tolist()
    if bad:
        raise ValueError(f"episodes {bad[:5]} {what}; expected one whole episode per row")


def pair_of(
    index: int, episode: Any, choices: int | None = None, keys: Sequence[str] | None = None
) -> tuple[Tensor, Tensor]:
    """The observations and actions of an episode, wide; raise ValueError if it is no pair."""
    try:
        observation, action = episode
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"episode {index} is a {type(episode).__name__}; expected a pair (observation, action)"
        ) from error
    states = observation_vectors(observation, keys, f"episode {index}: observation")
    if action is None:  # nobody recorded them
        return states, states.new_empty(max(len(states) - 1, 0), 0)
    return states, action_vectors(action, choices, f"episode {index}: action")


def flags_of(terminated: bool | Sequence[bool] | None, episodes: int) -> Tensor | None:
    """Whether each of so many episodes ended by itself, ``[M]``, of one flag or of one for each."""
    if terminated is None:
        return None
    flags = [terminated] * episodes if isinstance(terminated, bool) else list(terminated)
    if len(flags) != episodes:
        raise ValueError(
            f"terminated has {len(flags)} entries; expected one, or one for each of {episodes} "
            "episodes"
        )
    return torch.tensor(flags, dtype=torch.bool)


def task_of(
    task: Mapping[str, ArrayLike] | TensorDictBase | None, episodes: int
) -> TensorDictBase | None:
    """Task parameters of so many episodes as one batch."""
    if task is None or isinstance(task, TensorDictBase):
        return task
    values = {name: plain_tensor(value, f"task entry {name!r}") for name, value in task.items()}
    return task_batch(values, episodes)
