"""The gymnasium face: one episode (``gymnasium.make``) or a batch (``gymnasium.make_vec``)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from pemirl_envs.episodes import Episodes
from pemirl_envs.rendering import Renderer
from pemirl_envs.simulation import SimulationError
from pemirl_envs.tasks import TASKS, Task, get_task

Array = NDArray[Any]


def gym_id(name: str) -> str:
    """The gymnasium id of a task: ``point_maze/left`` is ``pemirl_envs/PointMazeLeft-v0``."""
    return f"pemirl_envs/{''.join(part.title() for part in name.replace('/', '_').split('_'))}-v0"


def register_tasks(names: Iterable[str]) -> None:
    """Registers tasks with gymnasium, by their names ``"domain/variant"``, unless they are."""
    for name in names:
        if gym_id(name) not in gymnasium.registry:
            gymnasium.register(
                gym_id(name),
                entry_point=f"{__name__}:GymEnv",
                vector_entry_point=f"{__name__}:GymVectorEnv",
                kwargs={"name": name},
            )


def check_ids(names: Iterable[str]) -> None:
    """Checks that new tasks have gymnasium ids of their own, before any is registered.

    Raises:
        ValueError: another task has the id: ``a_b/c`` and ``a/b_c`` would share theirs.
    """
    taken = {gym_id(name): name for name in TASKS}
    for name in names:
        other = taken.setdefault(gym_id(name), name)
        if other != name:
            raise ValueError(
                f"the gymnasium id {gym_id(name)} of {name!r} is taken by {other!r}; choose "
                "another name for the domain or its variant"
            )


class GymVectorEnv(VectorEnv[Array, Array, Array]):
    """``N`` episodes of a task on the batch engine, as a gymnasium vector environment.

    ``reset(options=...)`` takes ``{"task": {"goal": [...]}}``, one value for each episode or one
    for all, and gymnasium's ``{"reset_mask": bool [N]}``. ``info["task"]`` holds the parameters.
    Episodes that end begin anew in the same step (``AutoresetMode.SAME_STEP``): their last
    observations are in ``info["final_obs"]``.

    Args:
        name: the task, such as ``"point_maze/left"``.
        num_envs: the number of episodes, N.
        split: the set of tasks from which resets draw; default: ``task.default_split``.
        render_mode: ``"rgb_array"`` or ``None``.
        num_threads: threads that step the simulations; default: one for each usable CPU.

    Raises:
        ValueError: unknown task, split or render mode, or a count that is not positive.
    """

    metadata = {  # noqa: RUF012  # gymnasium types it as an instance variable, and reads the class
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": 20,
    }

    def __init__(
        self,
        name: str,
        num_envs: int = 1,
        *,
        split: str | None = None,
        render_mode: str | None = None,
        num_threads: int | None = None,
    ) -> None:
        _check_render_mode(render_mode)
        self.episodes = Episodes(get_task(name), num_envs, split=split, num_threads=num_threads)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_observation_space, self.single_action_space = _spaces(self.episodes.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._renderer: Renderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begins new episodes; see the class for the options."""
        super().reset(seed=seed)
        _reset(self.episodes, seed, options)
        return self.episodes.observe().numpy(), _info(self.episodes)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Acts once in every episode.

        Raises:
            ValueError: ``actions`` does not have the shape ``[N, A]``.
            SimulationError: some simulations failed; ``partial`` is what would be returned.
        """
        reward, failures = self.episodes.step(torch.tensor(np.asarray(actions)))
        observation, info = self.episodes.observe(), _info(self.episodes)
        ended = self.episodes.truncated()
        if ended.any():
            info["final_obs"], info["_final_obs"] = observation.numpy(), ended.numpy()
            info["final_info"] = {"task": info["task"]}
            self.episodes.reset(ended)
            observation, info["task"] = self.episodes.observe(), _info(self.episodes)["task"]
        terminated = np.zeros(self.num_envs, dtype=bool)
        result = (observation.numpy(), reward.numpy(), terminated, ended.numpy(), info)
        if failures:
            raise SimulationError(failures, result)
        return result

    def render(self) -> tuple[Array, ...] | None:
        """A frame for each episode, uint8 ``[H, W, 3]``, in render mode ``rgb_array``."""
        if self.render_mode is None:
            return None
        self._renderer = self._renderer or Renderer(self.episodes.task)
        return tuple(self._renderer.frame(row) for row in self.episodes.simulation.state)

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the renderer."""
        if self._renderer is not None:
            self._renderer.close()


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

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012  # as above

    def __init__(
        self, name: str, *, split: str | None = None, render_mode: str | None = None
    ) -> None:
        _check_render_mode(render_mode)
        self.episodes = Episodes(get_task(name), 1, split=split, num_threads=1)
        self.render_mode = render_mode
        self.observation_space, self.action_space = _spaces(self.episodes.task)
        self._renderer: Renderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begins a new episode; see the class for the options."""
        super().reset(seed=seed)
        _reset(self.episodes, seed, options)
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
        task = {name: value[0] for name, value in _info(self.episodes)["task"].items()}
        return self.episodes.observe()[0].numpy(), {"task": task}


def _spaces(task: Task) -> tuple[spaces.Box, spaces.Box]:
    low, high = (bound.numpy() for bound in task.action_bounds)
    observation = spaces.Box(-np.inf, np.inf, (task.observation_size,), np.float32)
    return observation, spaces.Box(low, high, dtype=np.float32)


def _check_render_mode(mode: str | None) -> None:
    if mode not in (None, "rgb_array"):
        raise ValueError(f"unknown render mode {mode!r}; expected 'rgb_array' or None")


def _reset(episodes: Episodes, seed: int | None, options: dict[str, Any] | None) -> None:
    if seed is not None:
        episodes.seed(seed)
    options = options or {}
    mask = options.get("reset_mask")
    episodes.reset(
        None if mask is None else torch.tensor(np.asarray(mask, dtype=bool)),
        _given_parameters(episodes, options["task"]) if "task" in options else None,
    )


def _given_parameters(episodes: Episodes, given: dict[str, Any]) -> dict[str, Tensor]:
    """One value for each episode or one for all, as ``[N, ...]``."""
    num_sims = episodes.simulation.num_sims
    bounds = episodes.task.parameter_bounds
    values = {name: torch.tensor(np.asarray(value)) for name, value in given.items()}
    return {
        name: value.expand(num_sims, *value.shape)
        if name in bounds and value.shape == bounds[name][0].shape
        else value
        for name, value in values.items()
    }


def _info(episodes: Episodes) -> dict[str, Any]:
    return {"task": {name: value.numpy().copy() for name, value in episodes.parameters.items()}}
