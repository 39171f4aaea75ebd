"""A pendulum with a motor, to be held at an angle that it does not observe; batched in torch."""

from __future__ import annotations

import dataclasses
import math

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from pemirl_trl import DemonstrationDataset, Provenance

T = 100  # steps of an episode, of DT each
DT = 0.05  # s
GRAVITY, LENGTH, MASS = 10.0, 1.0, 1.0  # m/s^2, m, kg
LIGHT = 0.25  # kg: damping that halves a speed in a step at 1 kg now makes it larger than before
MAX_TORQUE, MAX_SPEED = 8.0, 8.0  # N m, rad/s


class Pendulum(EnvBase):
    """Observes (cos, sin, angular velocity); motor=-1 reverses the torque, mass is in kg.

    It may be reset to ("task", "target"), the cosine and sine of an angle; its reward, which no
    learner reads, is minus the squared angle to it and a tenth of the squared speed.
    """

    def __init__(self, n: int, seed: int, motor: float = 1.0, mass: float = MASS) -> None:
        super().__init__(batch_size=[n])
        self.motor, self.mass = motor, mass
        self.generator = torch.Generator().manual_seed(seed)
        task = Composite(target=Unbounded((n, 2)), shape=[n])
        self.observation_spec = Composite(observation=Unbounded((n, 3)), task=task, shape=[n])
        self.action_spec = Bounded(-MAX_TORQUE, MAX_TORQUE, (n, 1))
        self.reward_spec = Unbounded((n, 1))

    def _reset(self, td: TensorDictBase | None, **_: object) -> TensorDictBase:
        n = self.batch_size[0]
        drawn = torch.rand(n, 3, generator=self.generator)
        self.angle, self.speed = math.tau * drawn[:, :1], 2 * drawn[:, 1:2] - 1
        target = None if td is None else td.get(("task", "target"), None)
        self.target = direction(math.tau * drawn[:, 2:]) if target is None else target.clone()
        return self._observed()

    def _step(self, td: TensorDictBase) -> TensorDictBase:
        before = td["observation"]
        reward = true_reward(before, self.target)
        torque = self.motor * td["action"].clamp(-MAX_TORQUE, MAX_TORQUE)
        pull = 1.5 * GRAVITY / LENGTH * self.angle.sin() + 3 / (self.mass * LENGTH**2) * torque
        self.speed = (self.speed + DT * pull).clamp(-MAX_SPEED, MAX_SPEED)
        self.angle = self.angle + DT * self.speed
        return self._observed().update(
            {"reward": reward, "done": torch.zeros_like(reward, dtype=torch.bool)}
        )

    def _observed(self) -> TensorDictBase:
        observation = torch.cat([direction(self.angle), self.speed], -1)
        task = TensorDict({"target": self.target.clone()}, self.batch_size)
        return TensorDict({"observation": observation, "task": task}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(0 if seed is None else seed)


def direction(angle: Tensor) -> Tensor:
    """(cos, sin) ``[..., 2]`` of angles ``[..., 1]``."""
    return torch.cat([angle.cos(), angle.sin()], -1)


def offset(observation: Tensor, target: Tensor) -> Tensor:
    """The angle ``[..., 1]`` from where the pendulum is to the target, in (-pi, pi]."""
    (cos, sin, _), (c, s) = observation.split(1, -1), target.split(1, -1)
    return torch.atan2(s * cos - c * sin, c * cos + s * sin)


def true_reward(observation: Tensor, target: Tensor) -> Tensor:
    """The reward ``[..., 1]``, of the step's start."""
    return -(offset(observation, target) ** 2 + 0.1 * observation[..., 2:] ** 2)


def controller(
    observation: Tensor, target: Tensor, motor: float = 1.0, mass: float = MASS
) -> Tensor:
    """The torque of whoever knows the target: a spring and a damper, and gravity made up for."""
    spring = 40 * offset(observation, target) - 12 * observation[..., 2:]
    gravity = 1.5 * GRAVITY / LENGTH * observation[..., 1:2]
    return (motor * mass * (spring - gravity) / 3).clamp(-MAX_TORQUE, MAX_TORQUE)


def make(num_envs: int, seed: int) -> EnvBase:
    """The environment of the demonstrations."""
    return Pendulum(num_envs, seed)


def make_reversed(num_envs: int, seed: int) -> EnvBase:
    """The same with the motor reversed."""
    return Pendulum(num_envs, seed, motor=-1.0)


def make_light(num_envs: int, seed: int) -> EnvBase:
    """The same with a quarter of the mass."""
    return Pendulum(num_envs, seed, mass=LIGHT)


def demonstrations(n: int, seed: int) -> DemonstrationDataset:
    """One demonstration of each of so many targets, by a controller with noise of 1 N m."""
    env, generator = Pendulum(n, seed), torch.Generator().manual_seed(seed + 1)

    def act(td: TensorDictBase) -> TensorDictBase:
        torque = controller(td["observation"], td["task", "target"])
        return td.set("action", torque + torch.randn(n, 1, generator=generator))

    return DemonstrationDataset.from_rollouts(env.rollout(T, act), Provenance("own_pendulum", seed))


def main() -> None:
    """Write what docs/tutorial.md records: demonstrations to train on, and ten of new targets."""
    new = demonstrations(10, seed=1)
    new.save("known.safetensors")  # with the targets, for the check at the end alone
    dataclasses.replace(new, task=None).save("new.safetensors")
    dataclasses.replace(demonstrations(400, seed=0), task=None).save("train.safetensors")


if __name__ == "__main__":
    main()
