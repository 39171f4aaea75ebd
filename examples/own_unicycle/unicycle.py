"""A unicycle that starts with any heading and is to reach a place that it does not observe."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from pemirl_trl import DemonstrationDataset, Provenance

T = 80  # steps of an episode, of DT each
DT = 0.1  # s
REACH = 2.0  # m, places are within it
NOISE = 0.15  # deviation of the demonstrator's actions, whose bounds are -1 and 1


class Unicycle(EnvBase):
    """Observes (x, y, cos, sin, speed, turning) in m, rad and s; motors=-1 reverses both actions.

    Actions, in [-1, 1], push forward and turn. It may be reset to ("task", "target"), a place in
    m; its reward, which no learner reads, is minus the distance to it.
    """

    def __init__(self, n: int, seed: int, motors: float = 1.0) -> None:
        super().__init__(batch_size=[n])
        self.motors = motors
        self.generator = torch.Generator().manual_seed(seed)
        task = Composite(target=Unbounded((n, 2)), shape=[n])
        self.observation_spec = Composite(observation=Unbounded((n, 6)), task=task, shape=[n])
        self.action_spec = Bounded(-1.0, 1.0, (n, 2))
        self.reward_spec = Unbounded((n, 1))

    def _reset(self, td: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        n = self.batch_size[0]
        drawn = torch.rand(n, 5, generator=self.generator)
        self.place = 0.4 * drawn[:, :2] - 0.2
        self.heading = math.tau * drawn[:, 2:3]
        self.speed, self.turning = torch.zeros(n, 1), torch.zeros(n, 1)
        target = None if td is None else td.get(("task", "target"), None)
        angle = math.tau * drawn[:, 4:]
        there = REACH * drawn[:, 3:4].sqrt() * torch.cat([angle.cos(), angle.sin()], -1)
        self.target = there if target is None else target.clone()
        return self._observed()

    def _step(self, td: TensorDictBase) -> TensorDictBase:
        reward = true_reward(td["observation"], self.target)
        push, turn = (self.motors * td["action"].clamp(-1.0, 1.0)).split(1, -1)
        self.speed = self.speed + DT * (2.0 * push - self.speed)
        self.turning = self.turning + DT * (6.0 * turn - 2.0 * self.turning)
        self.heading = self.heading + DT * self.turning
        ahead = torch.cat([self.heading.cos(), self.heading.sin()], -1)
        self.place = self.place + DT * self.speed * ahead
        return self._observed().update(
            {"reward": reward, "done": torch.zeros_like(reward, dtype=torch.bool)}
        )

    def _observed(self) -> TensorDictBase:
        direction = [self.heading.cos(), self.heading.sin()]
        observation = torch.cat([self.place, *direction, self.speed, self.turning], -1)
        task = TensorDict({"target": self.target.clone()}, self.batch_size)
        return TensorDict({"observation": observation, "task": task}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(0 if seed is None else seed)


def true_reward(observation: Tensor, target: Tensor) -> Tensor:
    """The reward ``[..., 1]``, of the step's start."""
    return -(observation[..., :2] - target).norm(dim=-1, keepdim=True)


def controller(observation: Tensor, target: Tensor, motors: float = 1.0) -> Tensor:
    """The actions ``[..., 2]`` of whoever knows the place, and the motors."""
    place, (cos, sin, speed, turning) = observation[..., :2], observation[..., 2:].split(1, -1)
    (x, y), distance = (target - place).split(1, -1), (target - place).norm(dim=-1, keepdim=True)
    angle = torch.atan2(cos * y - sin * x, cos * x + sin * y)
    far = (distance / 0.15).clamp(max=1.0)  # close by, the angle is noise
    push = 1.2 * distance * angle.cos().clamp(min=-0.2) - 0.6 * speed
    turn = 1.5 * far * angle - (0.3 + 0.2 * far) * turning
    return (motors * torch.cat([push, turn], -1)).clamp(-1.0, 1.0)


def make(num_envs: int, seed: int) -> EnvBase:
    """The environment of the demonstrations."""
    return Unicycle(num_envs, seed)


def make_reversed(num_envs: int, seed: int) -> EnvBase:
    """The same with both motors reversed."""
    return Unicycle(num_envs, seed, motors=-1.0)


def demonstrations(n: int, seed: int) -> DemonstrationDataset:
    """One demonstration of each of so many places, by a noisy controller."""
    env, generator = Unicycle(n, seed), torch.Generator().manual_seed(seed + 1)

    def act(td: TensorDictBase) -> TensorDictBase:
        action = controller(td["observation"], td["task", "target"])
        noisy = action + NOISE * torch.randn(n, 2, generator=generator)
        return td.set("action", noisy.clamp(-1.0, 1.0))

    return DemonstrationDataset.from_rollouts(env.rollout(T, act), Provenance("own_unicycle", seed))
