"""Whole episodes of a policy, and what they return."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, ExplorationType, set_exploration_type

Actor = Callable[[TensorDictBase], TensorDictBase] | None
"""Writes an ``action``; None draws actions uniformly."""


@torch.no_grad()
def whole_episodes(
    env: EnvBase, actor: Actor, horizon: int, *, sample: bool = False
) -> TensorDictBase:
    """Roll every environment out once, from its reset to the end: ``[N, T]``.

    Args:
        env: batch size ``[N]``.
        actor: maps what the environment writes to an action; None draws actions uniformly.
        horizon: T.
        sample: whether actions are drawn, or the distribution's mean (the default).
    """
    kind = ExplorationType.RANDOM if sample else ExplorationType.DETERMINISTIC
    with set_exploration_type(kind):
        return env.rollout(horizon, actor, break_when_any_done=False)


def episode_returns(
    env: EnvBase,
    policy: Actor,
    horizon: int,
    *,
    episodes_per_task: int,
    sample: bool = False,
) -> Tensor:
    """Undiscounted returns of whole episodes, averaged per task: ``[tasks]``.

    Args:
        env: batch size ``[tasks * episodes_per_task]``, task-major; its reward is the true one.
        policy, horizon, sample: as in :func:`whole_episodes`.
        episodes_per_task: consecutive environments that share a task.
    """
    rollouts = whole_episodes(env, policy, horizon, sample=sample)
    return returns_per_task(rollouts, episodes_per_task)


def returns_per_task(rollouts: TensorDictBase, episodes_per_task: int) -> Tensor:
    """Undiscounted returns of rollouts ``[tasks * episodes_per_task, T]``: means, ``[tasks]``."""
    returns = rollouts["next", "reward"].sum(-2).squeeze(-1)
    return returns.view(-1, episodes_per_task).mean(1)
