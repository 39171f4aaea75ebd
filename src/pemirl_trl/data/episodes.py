"""What makes episodes of what people have: arrays, batches of rollouts, flags."""

from __future__ import annotations

import math
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
    _check_not_stopped(done)
    last = torch.where(done.any(1), done.int().argmax(1), horizon - 1)
    return last + 1, terminated[torch.arange(rows), last]


def _check_not_stopped(done: Tensor) -> None:
    """Raise where a rollout stopped, for all rows, as soon as one was done ``[M, T]``."""
    stopped = done[:, -1] if not done[:, :-1].any() else done.new_zeros(1)
    if stopped.any() and not stopped.all():
        rows = stopped.nonzero().flatten().tolist()
        raise ValueError(
            f"the rollout stopped at step {done.shape[1]}, where episodes {rows[:5]} were done, "
            f"and {len(done) - len(rows)} others were not: they would be cut there. "
            "EnvBase.rollout stops at the first end unless you say break_when_all_done=True, which "
            "goes on until all have ended (or break_when_any_done=False, which resets each)"
        )


def check_constant(what: str, later: Tensor, earlier: Tensor, inside: Tensor) -> None:
    """Raise unless ``[M, T-1, ...]`` are equal wherever ``inside`` ``[M, T-1]``."""
    size = math.prod(later.shape[2:])  # -1 says nothing of rollouts of one step
    differ = (later != earlier).reshape(*inside.shape, size).any(-1) & inside
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
