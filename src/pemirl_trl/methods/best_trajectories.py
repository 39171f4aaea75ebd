"""For each task the best trajectory found so far, whichever task it was collected for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor

from pemirl_trl.modules.model import Policy
from pemirl_trl.modules.reading import acted_steps

_KEPT = ("observation", "action", "absorbing")  # the last where episodes end early
_STRIDE = 4  # steps between those that are scored: a ranking needs no more, and it is all the cost


@torch.no_grad()
def cross_returns(
    reward: TensorDictModuleBase, rollouts: TensorDictBase, tasks: TensorDictBase
) -> Tensor:
    """Return sum_t r(s_t, m_j) of every rollout under every task, ``[M, N]``.

    Args:
        reward: writes ``learned_reward`` ``[..., 1]``.
        rollouts: batch size ``[N, T]``.
        tasks: batch size ``[M]``; what a task is made of, such as ``context`` ``[M, D]``.
    """
    own = list(tasks.keys(include_nested=True, leaves_only=True))
    # r is a function of a step's start; f alone reads the next observation.
    here = [key for key in reward.in_keys if not (isinstance(key, tuple) and "next" in key)]
    data = rollouts.select(*(k for k in here if k not in own))

    def returns(task: TensorDictBase) -> Tensor:
        batch = data.copy()
        for key in own:
            batch.set(key, task[key].expand(*data.shape, -1))
        return reward(batch)["learned_reward"].squeeze(-1).sum(-1)

    return torch.vmap(returns, chunk_size=4)(tasks)


class BestTrajectories:
    """Self-imitation (Oh et al., 2018) across tasks, by relabelling (Eysenbach et al., 2020).

    A reward that is known as a function scores any trajectory under any task. What one task's
    policy stumbled upon is therefore found by all: a policy on the way to a near goal has passed
    the gap in the wall that the policy of a far goal, whose reward is flat there, would not look
    for.

    Args:
        reward: writes ``learned_reward``: a learned reward, or the true one for an oracle.
        rollouts_per_context: K; consecutive rollouts that share a task.
        action_bounds: ``(low, high)`` to which the simulator clamps; actions are kept clamped. A
            mean that imitates noise far beyond them would no longer feel its gradient once the
            noise is gone.
        task_keys: what a task is made of: all that reward and policy read beside observations and
            actions, each ``[M K, T, ...]`` in rollouts.
    """

    def __init__(
        self,
        reward: TensorDictModuleBase,
        rollouts_per_context: int,
        action_bounds: tuple[Tensor, Tensor] | None = None,
        *,
        task_keys: Sequence[NestedKey] = ("context",),
    ) -> None:
        self.reward, self.rollouts_per_context = reward, rollouts_per_context
        self.action_bounds, self.task_keys = action_bounds, tuple(task_keys)
        self._best: TensorDictBase | None = None  # [M]; observation and action [M, T, ...]

    def update(self, rollouts: TensorDictBase) -> dict[str, float]:
        """Take what is better than before; tasks are those of the first call, in its order.

        Args:
            rollouts: ``[M K, T]``, with the task's keys.

        Returns:
            Metrics: the mean best return, and the share of tasks whose best is new and was
            collected for another task.
        """
        tasks = rollouts[:: self.rollouts_per_context, 0].select(*self.task_keys).clone()
        best, row = cross_returns(self.reward, rollouts[:, ::_STRIDE], tasks).max(1)
        candidate = tasks.set("return", best)
        for key in _KEPT:
            if key not in rollouts:
                continue
            candidate.set(key, rollouts[key][row])
        if self.action_bounds is not None:
            low, high = (bound.to(best.device) for bound in self.action_bounds)
            candidate["action"] = candidate["action"].clamp(low, high)
        if self._best is None:
            self._best, better = candidate, torch.ones_like(best, dtype=torch.bool)
        else:
            self._best = self._best.to(best.device)  # a checkpoint's is on the CPU
            better = best > self._best["return"]
            self._best[better] = candidate[better]
        foreign = row // self.rollouts_per_context != torch.arange(len(best), device=best.device)
        return {
            "best/return": float(self._best["return"].mean()) * _STRIDE,
            "best/from_other_tasks": float((better & foreign).float().mean()),
        }

    def loss(self, policy: Policy, coeff: float) -> Callable[[], Tensor]:
        """() -> coeff/2 E |mu(s, m) - a|^2 over the steps of the best trajectories.

        The log-likelihood times the policy's variance: as the policy becomes precise, imitation
        gives way to the reward, whose gradient then grows. Of discrete actions mu are the
        probabilities, and this is half of Brier's score: as proper as the likelihood, and bounded.
        """
        if self._best is None:
            raise RuntimeError("no trajectories yet: call update first")
        steps = self._best["action"].shape[:2]
        batch = TensorDict({"observation": self._best["observation"]}, steps)
        for key in self.task_keys:
            batch.set(key, self._best[key].unsqueeze(1).expand(*steps, -1))
        batch, action = batch.reshape(-1), self._best["action"].flatten(0, 1)
        acted = acted_steps(self._best)
        if acted is not None:
            batch, action = batch[acted.flatten()], action[acted.flatten()]

        def loss() -> Tensor:
            error = policy.get_dist(batch.copy()).mean - action
            return 0.5 * coeff * error.square().sum(-1).mean()

        return loss

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {} if self._best is None else dict(self._best.flatten_keys(".").items())

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue a run."""
        self._best = None
        if state:
            self._best = TensorDict(state, [len(state["return"])]).unflatten_keys(".")
