"""True returns of a policy, task by task."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, ExplorationType, set_exploration_type


@torch.no_grad()
def episode_returns(
    env: EnvBase,
    policy: Callable[[TensorDictBase], TensorDictBase] | None,
    horizon: int,
    *,
    episodes_per_task: int,
    sample: bool = False,
) -> Tensor:
    """Undiscounted returns of whole episodes, averaged per task.

    Args:
        env: batch size ``[tasks * episodes_per_task]``, task-major; its reward is the true one.
        policy: maps what the environment writes to an action; None draws actions uniformly.
        horizon: T.
        episodes_per_task: consecutive environments that share a task.
        sample: whether actions are drawn, or the distribution's mean (the default).

    Returns:
        ``[tasks]``.
    """
    kind = ExplorationType.RANDOM if sample else ExplorationType.DETERMINISTIC
    with set_exploration_type(kind):
        rollouts = env.rollout(horizon, policy, break_when_any_done=False)
    returns = rollouts["next", "reward"].sum(-2).squeeze(-1)
    return returns.view(-1, episodes_per_task).mean(1)
