"""A puck on a table, to be pushed to a goal that it does not observe; batched in torch.

Its episodes differ in length: one ends when the puck is in the goal, or has fallen off the table.
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
EDGE = 1.0  # m, from the middle of the table to its edges
NEAREST, FARTHEST = 0.3, 0.8  # m, goals from the middle
GOAL_RADIUS = 0.1  # m
FALL = -100.0  # reward of falling


class Puck(EnvBase):
    """Observes (x, y, its velocity); push=-1 reverses the pushes.

    It may be reset to ("task", "goal"), a position; its reward, which no learner reads, is minus
    the distance to it, until the episode has ended, and FALL for falling.
    """

    def __init__(self, n: int, seed: int, push: float = 1.0) -> None:
        super().__init__(batch_size=[n])
        self.push, self.generator = push, torch.Generator().manual_seed(seed)
        self.state, self.goal = torch.zeros(n, 4), torch.zeros(n, 2)
        task = Composite(goal=Unbounded((n, 2)), shape=[n])
        self.observation_spec = Composite(observation=Unbounded((n, 4)), task=task, shape=[n])
        self.action_spec = Bounded(-MAX_PUSH, MAX_PUSH, (n, 2))
        self.reward_spec = Unbounded((n, 1))
        flags = {name: Binary(1, (n, 1), dtype=torch.bool) for name in ("done", "terminated")}
        self.full_done_spec = Composite(flags, shape=[n])

    def _reset(self, td: TensorDictBase | None, **_: object) -> TensorDictBase:
        n = self.batch_size[0]
        anew = None if td is None else td.get("_reset", None)
        anew = torch.ones(n, 1, dtype=torch.bool) if anew is None else anew.view(n, 1)
        drawn = torch.rand(n, 6, generator=self.generator)
        goal = None if td is None else td.get(("task", "goal"), None)
        self.goal = torch.where(anew, goals(drawn[:, :2]) if goal is None else goal, self.goal)
        self.state = torch.where(anew, 0.2 * (2 * drawn[:, 2:] - 1), self.state)
        return self._observed()

    def _step(self, td: TensorDictBase) -> TensorDictBase:
        reward = true_reward(td["observation"], self.goal)
        at, speed = self.state.split(2, -1)
        push = self.push * td["action"].clamp(-MAX_PUSH, MAX_PUSH)
        speed = speed + DT * (push - DRAG * speed)
        self.state = torch.cat([at + DT * speed, speed], -1)
        there, fallen = ends(self.state, self.goal)
        ended = there | fallen
        flags = {"done": ended, "terminated": ended.clone()}
        return self._observed().update({"reward": reward + FALL * fallen, **flags})

    def _observed(self) -> TensorDictBase:
        task = TensorDict({"goal": self.goal.clone()}, self.batch_size)
        return TensorDict({"observation": self.state.clone(), "task": task}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(0 if seed is None else seed)


def goals(drawn: Tensor) -> Tensor:
    """Positions ``[..., 2]`` around the middle, of numbers ``[..., 2]`` uniform in [0, 1)."""
    distance = NEAREST + (FARTHEST - NEAREST) * drawn[..., :1]
    angle = 2 * torch.pi * drawn[..., 1:]
    return distance * torch.cat([angle.cos(), angle.sin()], -1)


def ends(observation: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
    """Whether the puck is in the goal, and whether it has fallen, ``[..., 1]`` each."""
    at = observation[..., :2]
    return (at - goal).norm(dim=-1, keepdim=True) < GOAL_RADIUS, at.abs().amax(-1, True) > EDGE


def true_reward(observation: Tensor, goal: Tensor) -> Tensor:
    """The reward ``[..., 1]`` of a step that begins here, but for falling."""
    return -(observation[..., :2] - goal).norm(dim=-1, keepdim=True)


def controller(observation: Tensor, goal: Tensor, push: float = 1.0) -> Tensor:
    """The push of whoever knows the goal: a spring and a damper."""
    at, speed = observation[..., :4].split(2, -1)
    return (push * (4 * (goal - at) - 3 * speed)).clamp(-MAX_PUSH, MAX_PUSH)


def make(num_envs: int, seed: int) -> EnvBase:
    """The environment of the demonstrations."""
    return Puck(num_envs, seed)


def make_reversed(num_envs: int, seed: int) -> EnvBase:
    """The same with the pushes reversed."""
    return Puck(num_envs, seed, push=-1.0)


def demonstrations(n: int, seed: int) -> DemonstrationDataset:
    """One demonstration of each of so many goals, by a controller with noise of 0.5 m/s^2."""
    env, generator = Puck(n, seed), torch.Generator().manual_seed(seed + 1)

    def act(td: TensorDictBase) -> TensorDictBase:
        push = controller(td["observation"], td["task", "goal"])
        return td.set("action", push + 0.5 * torch.randn(n, 2, generator=generator))

    rollouts = env.rollout(T, act, break_when_any_done=False)  # the first episode of each row
    return DemonstrationDataset.from_rollouts(rollouts, Provenance("own_puck", seed))
