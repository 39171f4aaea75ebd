"""A puck on a round table, to be pushed over the edge at a place that it does not observe.

Its episodes differ in length: one ends when the puck has left the table. Batched in torch.
"""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from pemirl_trl import DemonstrationDataset, Provenance

T = 40  # steps of the longest episode, of DT each
DT = 0.1  # s
DRAG = 0.5  # 1/s
MAX_PUSH = 2.0  # m/s^2
EDGE = 1.0  # m, from the middle of the table to its edge


class Puck(EnvBase):
    """Observes (x, y, its velocity); push=-1 reverses the pushes.

    It may be reset to ("task", "gate"), a place on the edge. Its reward, which no learner reads, is
    minus the distance to the gate, and where the puck leaves the table T times that: as much as
    an episode there would cost.
    """

    def __init__(self, n: int, seed: int, push: float = 1.0) -> None:
        super().__init__(batch_size=[n])
        self.push, self.generator = push, torch.Generator().manual_seed(seed)
        self.state, self.gate = torch.zeros(n, 4), torch.zeros(n, 2)
        task = Composite(gate=Unbounded((n, 2)), shape=[n])
        self.observation_spec = Composite(observation=Unbounded((n, 4)), task=task, shape=[n])
        self.action_spec = Bounded(-MAX_PUSH, MAX_PUSH, (n, 2))
        self.reward_spec = Unbounded((n, 1))
        flags = {name: Binary(1, (n, 1), dtype=torch.bool) for name in ("done", "terminated")}
        self.full_done_spec = Composite(flags, shape=[n])

    def _reset(self, td: TensorDictBase | None, **_: object) -> TensorDictBase:
        n = self.batch_size[0]
        anew = None if td is None else td.get("_reset", None)
        anew = torch.ones(n, 1, dtype=torch.bool) if anew is None else anew.view(n, 1)
        drawn = torch.rand(n, 5, generator=self.generator)
        gate = None if td is None else td.get(("task", "gate"), None)
        self.gate = torch.where(anew, place(drawn[:, :1]) if gate is None else gate, self.gate)
        self.state = torch.where(anew, 0.2 * (2 * drawn[:, 1:] - 1), self.state)
        return self._observed()

    def _step(self, td: TensorDictBase) -> TensorDictBase:
        reward = true_reward(td["observation"], self.gate)
        at, speed = self.state.split(2, -1)
        push = self.push * td["action"].clamp(-MAX_PUSH, MAX_PUSH)
        speed = speed + DT * (push - DRAG * speed)
        self.state = torch.cat([at + DT * speed, speed], -1)
        left = has_left(self.state)
        reward = reward + T * left * true_reward(self.state, self.gate)
        flags = {"done": left, "terminated": left.clone()}
        return self._observed().update({"reward": reward, **flags})

    def _observed(self) -> TensorDictBase:
        task = TensorDict({"gate": self.gate.clone()}, self.batch_size)
        return TensorDict({"observation": self.state.clone(), "task": task}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(0 if seed is None else seed)


def place(share: Tensor) -> Tensor:
    """Where on the edge ``[..., 2]``, for shares of a turn ``[..., 1]``."""
    angle = 2 * torch.pi * share
    return EDGE * torch.cat([angle.cos(), angle.sin()], -1)


def has_left(observation: Tensor) -> Tensor:
    """Whether the puck has left the table, ``[..., 1]``."""
    return observation[..., :2].norm(dim=-1, keepdim=True) > EDGE


def true_reward(observation: Tensor, gate: Tensor) -> Tensor:
    """The reward ``[..., 1]`` of a step that begins here, on the table."""
    return -(observation[..., :2] - gate).norm(dim=-1, keepdim=True)


def controller(observation: Tensor, gate: Tensor, push: float = 1.0) -> Tensor:
    """The push of whoever knows the gate: a spring to a place beyond it, and a damper."""
    at, speed = observation[..., :4].split(2, -1)
    return (push * (4 * (1.2 * gate - at) - 3 * speed)).clamp(-MAX_PUSH, MAX_PUSH)


def make(num_envs: int, seed: int) -> EnvBase:
    """The environment of the demonstrations."""
    return Puck(num_envs, seed)


def make_reversed(num_envs: int, seed: int) -> EnvBase:
    """The same with the pushes reversed."""
    return Puck(num_envs, seed, push=-1.0)


def demonstrations(n: int, seed: int) -> DemonstrationDataset:
    """One demonstration of each of so many gates, by a controller with noise of 0.5 m/s^2."""
    env, generator = Puck(n, seed), torch.Generator().manual_seed(seed + 1)

    def act(td: TensorDictBase) -> TensorDictBase:
        push = controller(td["observation"], td["task", "gate"])
        return td.set("action", push + 0.5 * torch.randn(n, 2, generator=generator))

    rollouts = env.rollout(T, act, break_when_any_done=False)  # the first episode of each row
    return DemonstrationDataset.from_rollouts(rollouts, Provenance("own_puck", seed))
