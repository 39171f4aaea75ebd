"""For each task the best trajectory found so far, whichever task it was collected for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from pemirl_trl.modules import ContextPolicy

_KEPT = ("observation", "action")
_STRIDE = 4  # steps between those that are scored: a ranking needs no more, and it is all the cost


@torch.no_grad()
def cross_returns(
    reward: TensorDictModuleBase, rollouts: TensorDictBase, context: Tensor
) -> Tensor:
    """Learned return sum_t r(s_t, m_j) of every rollout under every context, ``[M, N]``.

    Args:
        reward: reads ``context`` and writes ``learned_reward``.
        rollouts: batch size ``[N, T]``.
        context: m, ``[M, D]``.
    """
    # r is a function of a step's start; f alone reads the next observation.
    here = [k for k in reward.in_keys if not (isinstance(k, tuple) and k[0] == "next")]
    data = rollouts.select(*(k for k in here if k != "context"))

    def returns(m: Tensor) -> Tensor:
        batch = data.copy().set("context", m.expand(*data.shape, -1))
        return reward(batch)["learned_reward"].squeeze(-1).sum(-1)

    return torch.vmap(returns, chunk_size=4)(context)


class BestTrajectories:
    """Self-imitation (Oh et al., 2018) across tasks, by relabelling (Eysenbach et al., 2020).

    A learned reward scores any trajectory under any task. What one task's policy stumbled upon is
    therefore found by all: a policy on the way to a near goal has passed the gap in the wall that
    the policy of a far goal, whose reward is flat there, would not look for.

    Args:
        reward: reads ``context`` and writes ``learned_reward``.
        rollouts_per_context: K; consecutive rollouts that share a context.
        action_bounds: ``(low, high)`` to which the simulator clamps; actions are kept clamped. A
            mean that imitates noise far beyond them would no longer feel its gradient once the
            noise is gone.
    """

    def __init__(
        self,
        reward: TensorDictModuleBase,
        rollouts_per_context: int,
        action_bounds: tuple[Tensor, Tensor] | None = None,
    ) -> None:
        self.reward, self.rollouts_per_context = reward, rollouts_per_context
        self.action_bounds = action_bounds
        self._best: TensorDict | None = None  # [M]; observation and action [M, T, ...]

    def update(self, rollouts: TensorDictBase) -> dict[str, float]:
        """Take what is better than before; contexts are those of the first call, in its order.

        Args:
            rollouts: ``[M K, T]``, with ``context``.

        Returns:
            Metrics: the mean best return, and the share of tasks whose best is new and was
            collected for another task.
        """
        context = rollouts["context"][:: self.rollouts_per_context, 0]
        best, row = cross_returns(self.reward, rollouts[:, ::_STRIDE], context).max(1)
        candidate = TensorDict(
            {key: rollouts[key][row] for key in _KEPT}
            | {
                "context": rollouts["context"][:: self.rollouts_per_context].clone(),
                "return": best,
            },
            [len(context)],
        )
        if self.action_bounds is not None:
            candidate["action"] = candidate["action"].clamp(*self.action_bounds)
        if self._best is None:
            self._best, better = candidate, torch.ones_like(best, dtype=torch.bool)
        else:
            better = best > self._best["return"]
            self._best[better] = candidate[better]
        foreign = row // self.rollouts_per_context != torch.arange(len(context))
        return {
            "best/return": float(self._best["return"].mean()) * _STRIDE,
            "best/from_other_tasks": float((better & foreign).float().mean()),
        }

    def loss(self, policy: ContextPolicy, coeff: float) -> Callable[[], Tensor]:
        """() -> coeff/2 E |mu(s, m) - a|^2 over the steps of the best trajectories.

        The log-likelihood times the policy's variance: as the policy becomes precise, imitation
        gives way to the reward, whose gradient then grows.
        """
        if self._best is None:
            raise RuntimeError("no trajectories yet: call update first")
        best = self._best
        observation, context, action = (
            best[key].flatten(0, 1) for key in ("observation", "context", "action")
        )
        batch = TensorDict({"observation": observation, "context": context}, action.shape[:1])

        def loss() -> Tensor:
            error = policy.get_dist(batch.copy()).mean - action
            return 0.5 * coeff * error.square().sum(-1).mean()

        return loss

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {} if self._best is None else dict(self._best.items())

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue a run."""
        self._best = TensorDict(state, [len(state["return"])]) if state else None
