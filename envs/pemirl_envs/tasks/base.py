"""A task, written once as torch functions of named engine fields with a leading batch dimension."""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import mujoco
import torch
from torch import Generator, Tensor

from pemirl_envs.simulation import Fields, State
from pemirl_envs.tasks.quantities import (
    Component,
    Controller,
    Outcome,
    Parameters,
    component_slice,
)

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
        observation_components: the parts of an observation, in order, by name and with units.
        task_space: the names of those that the tasks are about (Gymnasium: ``achieved_goal``).
        outcomes: what a person would look at beside the return, by a name that ends in its unit.
        planar: whether the observation is a position in the plane, of which ``layout`` is the map.
        parameter_bounds: the legal box of each parameter, by name: float32 ``(low, high)``.
        splits: the names of the sets of tasks to draw from.
        default_split: the one that the faces draw from unless told: the training set.
    """

    horizon: ClassVar[int]
    n_sub_steps: ClassVar[int]
    stage: ClassVar[mujoco.mjtStage] = mujoco.mjtStage.mjSTAGE_NONE
    observation_components: ClassVar[tuple[Component, ...]]
    task_space: ClassVar[tuple[str, ...]]
    outcomes: ClassVar[Mapping[str, Outcome]] = MappingProxyType({})
    planar: ClassVar[bool] = False
    parameter_bounds: Mapping[str, tuple[Tensor, Tensor]]
    splits: tuple[str, ...]
    default_split: ClassVar[str] = "train_100"

    @functools.cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model. Shared: engines copy it, nobody edits it."""
        return self.build_spec().compile()

    def models(self, parameters: Parameters) -> Sequence[mujoco.MjModel] | None:
        """The model of each of ``N`` episodes, of one size, where parameters tell them apart.

        None, the default: all run on :attr:`model`. The models are shared, as that is.
        """
        return None

    @functools.cached_property
    def action_bounds(self) -> tuple[Tensor, Tensor]:
        """The control range, float32 ``(low [A], high [A])``; actions are clipped to it."""
        low, high = torch.from_numpy(self.model.actuator_ctrlrange.copy()).float().unbind(-1)
        return low, high

    @property
    def observation_size(self) -> int:
        """S, the length of an observation."""
        return sum(component.size for component in self.observation_components)

    @classmethod
    def component_slice(cls, name: str) -> slice:
        """Where the component of this name stands in an observation.

        Raises:
            ValueError: there is none; lists those that there are.
        """
        return component_slice(cls.observation_components, name)

    @classmethod
    def components(cls, names: Iterable[str]) -> list[int]:
        """The indices of all numbers of these components, in the order of the names.

        Raises:
            ValueError: there is no component of such a name; lists those that there are.
        """
        slices = [cls.component_slice(name) for name in names]
        return [index for part in slices for index in range(part.start, part.stop)]

    @classmethod
    def task_space_indices(cls) -> list[int]:
        """The indices of the numbers of an observation that the tasks are about."""
        return cls.components(cls.task_space)

    @property
    def task_key(self) -> str:
        """The parameter that tells tasks apart, which an expert reads: the only one.

        Raises:
            ValueError: there are several, and the task does not say which.
        """
        if len(self.parameter_bounds) != 1:
            raise ValueError(
                f"{type(self).__name__} has the parameters {sorted(self.parameter_bounds)}; "
                "expected one, or a class attribute task_key that names the one an expert reads"
            )
        return next(iter(self.parameter_bounds))

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
        """What the agent sees, float32 ``[N, S]``. Holds nothing of the parameters."""

    @abc.abstractmethod
    def reward(self, fields: Fields, action: Tensor, parameters: Parameters) -> Tensor:
        """r(s_t, a_t), float32 ``[N]``: read before the physics moves, for the clipped action."""

    def control(self, fields: Fields, action: Tensor) -> State:
        """The state fields through which a clipped action ``[N, A]`` drives the model."""
        return {"ctrl": action}

    def disturb(self, fields: Fields, generator: Generator) -> State:
        """Random changes of the state after each control step; none by default."""
        return {}

    def observed_fields(self, observation: Tensor) -> State:
        """What ``reward`` reads of the engine's fields, float64, from observations ``[N, S]``.

        Raises:
            ValueError: the task cannot tell them from an observation.
        """
        raise ValueError(
            f"{type(self).__name__} defines no observed_fields: its reward cannot be computed from "
            "an observation"
        )

    def state_reward(self, observation: Tensor, action: Tensor, parameters: Parameters) -> Tensor:
        """The true reward of any transition, possible or not, up to an observation's rounding.

        Args:
            observation: ``[..., S]``.
            action: ``[..., A]``, clipped to its bounds.
            parameters: each ``[..., *P]``, where ``*P`` is the shape of its bounds.

        Returns:
            float32 ``[...]``.

        Raises:
            ValueError: the reward depends on more than what is observed.
        """
        low, high = self.action_bounds
        fields = self.observed_fields(observation.flatten(0, -2))
        control = action.flatten(0, -2).clamp(low, high)
        rows = {
            name: parameters[name].reshape(-1, *bound.shape)
            for name, (bound, _) in self.parameter_bounds.items()
        }
        return self.reward(fields.__getitem__, control, rows).view(observation.shape[:-1])

    def scripted_controller(self) -> Controller | None:
        """A controller by hand, which learned nothing; None where the task has none."""
        return None

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
