"""One episode of a task as a gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch

from pemirl_envs.episodes import Episodes
from pemirl_envs.gym.conversion import (
    Array,
    check_options,
    check_render_mode,
    given_parameters,
    task_spaces,
)
from pemirl_envs.rendering import Renderer
from pemirl_envs.simulation import Seed, SimulationError, generator_seed
from pemirl_envs.tasks import get_task


class GymEnv(gymnasium.Env[Array, Array]):
    """One episode of a task as a gymnasium environment.

    ``reset(options={"task": {"goal": (0.3, 0.5)}})`` chooses the task; ``info["task"]`` holds it.

    Args:
        name: the task, such as ``"point_maze/left"``.
        split: the set of tasks from which resets draw; default: ``task.default_split``.
        render_mode: ``"rgb_array"`` or ``None``.

    Raises:
        ValueError: unknown task, split or render mode.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012  # gymnasium's

    def __init__(
        self, name: str, *, split: str | None = None, render_mode: str | None = None
    ) -> None:
        check_render_mode(render_mode)
        self.episodes = Episodes(get_task(name), 1, split=split, num_threads=1)
        self.render_mode = render_mode
        self.observation_space, self.action_space = task_spaces(self.episodes.task)
        self._renderer: Renderer | None = None

    def reset(
        self, *, seed: Seed = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begins a new episode; see the class for the options.

        Raises:
            TypeError, ValueError: illegal seed, options or task parameters.
        """
        check_options(options, ["task"])
        if seed is not None:
            seed = generator_seed(seed)
            self.episodes.seed(seed)
        super().reset(seed=seed)
        self.episodes.reset(parameters=given_parameters(self.episodes, options))
        return self._observed()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Acts once.

        Raises:
            ValueError: ``action`` does not have the shape ``[A]``.
            SimulationError: the simulation failed, and has not moved.
        """
        reward, failures = self.episodes.step(torch.tensor(np.asarray(action))[None])
        observation, info = self._observed()
        result = (observation, float(reward), False, bool(self.episodes.truncated()), info)
        if failures:
            raise SimulationError(failures, result)
        return result

    def render(self) -> Array | None:
        """A frame, uint8 ``[H, W, 3]``, in render mode ``rgb_array``."""
        if self.render_mode is None:
            return None
        self._renderer = self._renderer or Renderer(self.episodes.task)
        return self._renderer.frame(self.episodes.simulation.state[0])

    def close(self) -> None:
        """Frees the renderer."""
        if self._renderer is not None:
            self._renderer.close()

    def _observed(self) -> tuple[Array, dict[str, Any]]:
        parameters = self.episodes.parameters
        task = {name: value[0].numpy().copy() for name, value in parameters.items()}
        return self.episodes.observe()[0].numpy(), {"task": task}
