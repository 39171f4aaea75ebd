"""A deterministic environment of N points on a line, for tests of transforms."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase


class Line(EnvBase):
    """s' = s + a and reward -(s' - goal)^2, for ``horizon`` steps; the task is the goal.

    The position starts at zero. Without a ``task`` at reset the goal stays what it was.
    """

    batch_locked = True

    def __init__(self, num_envs: int, horizon: int = 3) -> None:
        super().__init__(batch_size=[num_envs])
        self.horizon = horizon
        shape = (num_envs, 1)
        self.position, self.goal = torch.zeros(shape), torch.zeros(shape)
        self.time = torch.zeros(shape, dtype=torch.int64)
        task = Composite(goal=Unbounded(shape), shape=self.batch_size)
        self.observation_spec = Composite(
            observation=Unbounded((num_envs, 2)), task=task, shape=self.batch_size
        )
        self.action_spec = Unbounded(shape)
        self.reward_spec = Unbounded(shape)
        flags = {k: Binary(1, shape, dtype=torch.bool) for k in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flags, shape=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        """Nothing is random."""

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: object) -> TensorDict:
        mask = torch.ones_like(self.time, dtype=torch.bool)
        if tensordict is not None:
            mask = tensordict.get("_reset", mask).view_as(mask)
            self.goal = torch.where(mask, tensordict.get(("task", "goal"), self.goal), self.goal)
        self.position = self.position.masked_fill(mask, 0.0)
        self.time = self.time.masked_fill(mask, 0)
        return self._state(torch.zeros_like(mask))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self.position, self.time = self.position + tensordict["action"], self.time + 1
        reward = -(self.position - self.goal).square()
        return self._state(self.time >= self.horizon).set("reward", reward)

    def _state(self, truncated: torch.Tensor) -> TensorDict:
        return TensorDict(
            {
                "observation": torch.cat([self.position, self.time.to(self.position)], -1),
                "task": {"goal": self.goal},
                "done": truncated,
                "terminated": torch.zeros_like(truncated),
                "truncated": truncated.clone(),
            },
            self.batch_size,
        )
