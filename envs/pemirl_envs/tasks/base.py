"""A task, written once as torch functions of named engine fields with a leading batch dimension."""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import mujoco
import torch
from torch import Generator, Tensor

from pemirl_envs.simulation import Fields, State

Parameters = Mapping[str, Tensor]
"""What distinguishes one task of a family from another (a goal, a direction), each ``[N, ...]``."""

Point = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Layout:
    """The plan of a planar task, for figures. Lengths in metres.

    Attributes:
        walls: the centre line of every wall, by name.
        wall_radius: half the thickness of a wall.
        start: where an episode begins, before the random offset.
        low: lower left corner of the walls' centre lines.
        high: upper right corner.
    """

    walls: dict[str, tuple[Point, Point]]
    wall_radius: float
    start: Point
    low: Point
    high: Point


class Task(abc.ABC):
    """A family of tasks on one model, told apart by their parameters.

    Methods are pure: they read ``fields(name)`` and return new tensors. Randomness comes from the
    generator that they are given, and how much of it they draw depends on ``n`` alone.

    Attributes:
        horizon: control steps in an episode. Every episode has this length.
        n_sub_steps: physics steps in one control step.
        stage: the forward stage that fills the derived fields which the task reads.
        observation_size: D, the length of an observation.
        parameter_bounds: the legal box of each parameter, by name: float32 ``(low, high)``.
        splits: the names of the sets of tasks to draw from.
        default_split: the one that the faces draw from unless told: the training set.
    """

    horizon: ClassVar[int]
    n_sub_steps: ClassVar[int]
    stage: ClassVar[mujoco.mjtStage] = mujoco.mjtStage.mjSTAGE_NONE
    observation_size: ClassVar[int]
    parameter_bounds: Mapping[str, tuple[Tensor, Tensor]]
    splits: tuple[str, ...]
    default_split: ClassVar[str] = "train_100"

    @functools.cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model. Shared: engines copy it, nobody edits it."""
        return self.build_spec().compile()

    @functools.cached_property
    def action_bounds(self) -> tuple[Tensor, Tensor]:
        """The control range, float32 ``(low [A], high [A])``; actions are clipped to it."""
        low, high = torch.from_numpy(self.model.actuator_ctrlrange.copy()).float().unbind(-1)
        return low, high

    @property
    def control_timestep(self) -> float:
        """Seconds between two actions."""
        return float(self.model.opt.timestep) * self.n_sub_steps

    @abc.abstractmethod
    def build_spec(self) -> mujoco.MjSpec:
        """The model of this variant, as a specification that can still be edited."""

    @abc.abstractmethod
    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Draws the parameters of ``n`` tasks from a split.

        Raises:
            ValueError: the task has no such split.
        """

    @abc.abstractmethod
    def task_set(self, split: str) -> dict[str, Tensor]:
        """All tasks of a finite split.

        Raises:
            ValueError: the split is unknown, or a distribution that never ends.
        """

    @abc.abstractmethod
    def initial_state(self, parameters: Parameters, generator: Generator) -> State:
        """Draws the state in which ``N`` episodes begin, given their parameters."""

    @abc.abstractmethod
    def observe(self, fields: Fields) -> Tensor:
        """What the agent sees, float32 ``[N, D]``. Holds nothing of the parameters."""

    @abc.abstractmethod
    def reward(self, fields: Fields, action: Tensor, parameters: Parameters) -> Tensor:
        """r(s_t, a_t), float32 ``[N]``: read before the physics moves, for the clipped action."""

    def control(self, fields: Fields, action: Tensor) -> State:
        """The state fields through which a clipped action ``[N, A]`` drives the model."""
        return {"ctrl": action}

    def disturb(self, fields: Fields, generator: Generator) -> State:
        """Random changes of the state after each control step; none by default."""
        return {}

    def layout(self) -> Layout:
        """The plan of a planar task.

        Raises:
            ValueError: the task is not planar.
        """
        raise ValueError(f"{type(self).__name__} is not a planar task, so it has no layout")

    def validate_parameters(
        self, parameters: Parameters, n: int, mask: Tensor | None = None
    ) -> None:
        """Checks that the parameters of ``n`` tasks are complete and inside ``parameter_bounds``.

        Args:
            parameters: the values, by name.
            n: how many there must be of each.
            mask: the rows whose values matter, bool ``[n]``; ``None``: all.

        Raises:
            ValueError: they are not; names the parameter, the simulations and the legal box.
        """
        if parameters.keys() != self.parameter_bounds.keys():
            raise ValueError(
                f"expected the task parameters {sorted(self.parameter_bounds)}, "
                f"got {sorted(parameters)}"
            )
        for name, (low, high) in self.parameter_bounds.items():
            value = parameters[name]
            if value.shape != (n, *low.shape):
                raise ValueError(
                    f"expected {name} of shape {[n, *low.shape]}, got {list(value.shape)}"
                )
            legal = ((value >= low) & (value <= high)).flatten(1).all(1)  # False for NaN
            if mask is not None:
                legal |= ~mask
            if not legal.all():
                bad = (~legal).nonzero().flatten().tolist()
                raise ValueError(
                    f"{name} of simulation(s) {bad[:5]} is {value[bad[:5]].tolist()}; legal values "
                    f"lie between {low.tolist()} and {high.tolist()}"
                )
