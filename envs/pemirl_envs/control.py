"""The dm_control face: one episode of a task at a time, as a ``dm_env`` environment."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import dm_env.specs
import mujoco
import numpy as np
import torch
from dm_control.mujoco import Physics
from dm_control.mujoco.wrapper import MjModel
from dm_control.rl import control
from numpy.typing import ArrayLike
from torch import Generator, Tensor

from pemirl_envs.episodes import check_action, draw_episode, observe
from pemirl_envs.simulation import Seed, SimulationError, State, generator_seed
from pemirl_envs.tasks import Task


def load(
    task: Task,
    *,
    split: str | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    random: Seed = None,
    time_limit: float | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
) -> control.Environment:
    """Builds the environment of a task; see :func:`pemirl_envs.load` for the arguments.

    Raises:
        ValueError: unknown split, or illegal parameters.
    """
    return control.Environment(
        Physics.from_model(MjModel(task.model)),
        ControlTask(task, split=split, parameters=parameters, random=random),
        time_limit=task.horizon * task.control_timestep if time_limit is None else time_limit,
        n_sub_steps=task.n_sub_steps,
        **(environment_kwargs or {}),
    )


class ControlTask(control.Task):
    """A task for ``dm_control.rl.control.Environment``.

    Rewards are r(s_t, a_t): read from the state before the physics moves. A diverging simulation
    raises dm_control's ``PhysicsError``, a non-finite action :class:`~pemirl_envs.SimulationError`.

    Args:
        task: the task.
        split: the set of tasks from which episodes draw; ``None``: ``task.default_split``.
        parameters: task parameters of every episode, each without a batch dimension; ``None`` draws
            them from the split.
        random: a seed of any type that :func:`~pemirl_envs.simulation.generator_seed` knows;
            ``None`` takes one from the operating system.

    Attributes:
        parameters: the task parameters of the current episode, each ``[1, ...]``.

    Raises:
        TypeError: what is given as a seed is none.
        ValueError: unknown split, or illegal parameters.
    """

    def __init__(
        self,
        task: Task,
        *,
        split: str | None = None,
        parameters: Mapping[str, ArrayLike] | None = None,
        random: Seed = None,
    ) -> None:
        split = task.default_split if split is None else split
        if split not in task.splits:
            raise ValueError(f"unknown split {split!r}; expected one of {task.splits}")
        self._task = task
        self._split = split
        self._given = None
        if parameters is not None:
            self._given = {k: torch.tensor(np.asarray(v))[None] for k, v in parameters.items()}
            task.validate_parameters(self._given, 1)
        if not isinstance(random, np.random.RandomState):
            random = np.random.RandomState(generator_seed(random))
        self._random = random
        self.parameters: dict[str, Tensor] = {}
        self._reward = 0.0

    @property
    def random(self) -> np.random.RandomState:
        """The ``RandomState`` that seeded this task. Its seed is used, it is never drawn from."""
        return self._random

    @property
    def _random(self) -> np.random.RandomState:
        return self._random_state

    @_random.setter
    def _random(self, state: np.random.RandomState) -> None:
        # TorchRL's DMControlWrapper seeds an environment by assigning to this name.
        self._random_state = state
        self._generator = Generator().manual_seed(generator_seed(state))

    def initialize_episode(self, physics: Physics) -> None:
        """Draws the task parameters and the initial state."""
        self.parameters, state = draw_episode(
            self._task, 1, self._split, self._given, self._generator
        )
        _write(physics, state)

    def before_step(self, action: np.ndarray, physics: Physics) -> None:
        """Sets the control, and reads the reward before the physics moves.

        Raises:
            ValueError: the action has a wrong shape.
            SimulationError: the action is not finite.
        """
        low, high = self._task.action_bounds
        applied = torch.tensor(np.asarray(action))
        if not check_action(applied, low.shape):
            raise SimulationError({0: "the action is not finite"})
        applied = torch.clamp(applied[None], low, high)
        reward = self._task.reward(lambda name: _field(physics, name), applied, self.parameters)
        self._reward = float(reward[0])
        state = self._task.control(lambda name: _field(physics, name), applied)
        _write(physics, state)

    def after_step(self, physics: Physics) -> None:
        """Adds the task's transition noise."""
        state = self._task.disturb(lambda name: _field(physics, name), self._generator)
        _write(physics, state)

    def get_observation(self, physics: Physics) -> OrderedDict[str, np.ndarray]:
        """The observation, float32 ``[S]``, under the key ``observation``."""
        observation = observe(self._task, lambda name: _field(physics, name))
        return OrderedDict(observation=observation[0].numpy())

    def get_reward(self, physics: Physics) -> float:
        """r(s_t, a_t) of the step just made."""
        return self._reward

    def action_spec(self, physics: Physics) -> dm_env.specs.BoundedArray:
        """The task's action bounds."""
        low, high = (bound.numpy() for bound in self._task.action_bounds)
        return dm_env.specs.BoundedArray(low.shape, np.float32, low, high, name="action")


def _field(physics: Physics, name: str) -> Tensor:
    return torch.from_numpy(np.asarray(getattr(physics.data, name)))[None]


def _write(physics: Physics, state: State) -> None:
    for name, values in state.items():
        _field(physics, name).copy_(values)
    if state.keys() - {"ctrl"}:
        # The environment's next step goes on from the position and velocity stages of this state.
        mujoco.mj_step1(physics.model.ptr, physics.data.ptr)
