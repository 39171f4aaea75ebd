"""A task on a model file of Gymnasium's, many simulations at a time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import gymnasium
import mujoco
import torch
from tensordict import TensorDictBase
from torch import Generator, Tensor

from pemirl_envs import Fields, Parameters, Task

Expert = Callable[[TensorDictBase], TensorDictBase]
"""Reads the task, writes an action."""
ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"


class GymnasiumTask(Task):
    """Gymnasium's model, steps and observations, with a hidden parameter that a reset may give.

    Dynamics are those of the environment that Gymnasium registers, to the last bit. Two things are
    different: nothing about the task is observed, and the reward is that of a step's start, r(s_t,
    a_t), where Gymnasium's reads the state that follows.

    Attributes:
        xml: the model, a file among Gymnasium's assets.
    """

    xml: ClassVar[str]
    splits = ("uniform",)
    default_split = "uniform"

    def build_spec(self) -> mujoco.MjSpec:
        """Gymnasium's model."""
        return mujoco.MjSpec.from_file(str(ASSETS / self.xml))

    def task_set(self, split: str) -> dict[str, Tensor]:
        """There is no finite split.

        Raises:
            ValueError: always.
        """
        raise ValueError(f"{split!r} is not a finite split; there is none")

    def reward(self, fields: Fields, action: Tensor, parameters: Parameters) -> Tensor:
        """r(s_t, a_t), float32 ``[N]``, of what is observed."""
        value = parameters[self.task_key]
        return self.true_reward(self.observe(fields), action, value)[..., 0]

    @classmethod
    def true_reward(cls, observation: Tensor, action: Tensor, value: Tensor) -> Tensor:
        """The reward ``[..., 1]`` for the parameter's value; no learner reads it."""
        return torch.stack([*cls.terms(observation, action, value).values()]).sum(0)

    @staticmethod
    def terms(observation: Tensor, action: Tensor, value: Tensor) -> dict[str, Tensor]:
        """What adds up to the true reward, each ``[..., 1]``, by name."""
        raise NotImplementedError


def uniform(*shape: int, bound: float, generator: Generator) -> Tensor:
    """Uniform draws from [-bound, bound], float64."""
    return bound * (2 * torch.rand(*shape, dtype=torch.float64, generator=generator) - 1)
