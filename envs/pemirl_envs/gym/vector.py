"""Many episodes of a task as a gymnasium vector environment, on the batch engine."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from pemirl_envs.episodes import Episodes, check_action
from pemirl_envs.gym.conversion import (
    Array,
    Options,
    check_options,
    check_render_mode,
    given_parameters,
    task_spaces,
)
from pemirl_envs.rendering import Renderer
from pemirl_envs.simulation import Seed, SimulationError, generator_seed
from pemirl_envs.tasks import get_task


class GymVectorEnv(VectorEnv[Array, Array, Array]):
    """``N`` episodes of a task on the batch engine, as a gymnasium vector environment.

    ``reset(options=...)`` takes ``{"task": {"goal": [...]}}``, one value for each episode or one
    for all, and gymnasium's ``{"reset_mask": bool [N]}``. ``info["task"]`` holds the parameters.
    A seed starts one stream for all episodes, not one for each as in ``SyncVectorEnv``.

    Episodes that end begin anew as gymnasium's modes say: in the same step (their last observations
    are in ``info["final_obs"]`` and their info in ``info["final_info"]``), in the next one (which
    ignores their actions and rewards them with 0), or when they are reset.

    Args:
        name: the task, such as ``"point_maze/left"``.
        num_envs: the number of episodes, N.
        split: the set of tasks from which resets draw; default: ``task.default_split``.
        render_mode: ``"rgb_array"`` or ``None``.
        num_threads: threads that step the simulations; default: one for each usable CPU.
        autoreset_mode: an ``AutoresetMode`` or its value: ``"SameStep"``, ``"NextStep"`` or
            ``"Disabled"``.
        max_episode_steps: truncates episodes earlier than the task's horizon does; ``None`` (and,
            as in ``gymnasium.make``, -1): they have the horizon's length.

    Raises:
        ValueError: unknown task, split or mode, or a count that is not positive.
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
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        max_episode_steps: int | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.episodes = Episodes(
            get_task(name),
            num_envs,
            split=split,
            num_threads=num_threads,
            max_steps=_max_steps(max_episode_steps),
        )
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_observation_space, self.single_action_space = task_spaces(self.episodes.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._renderer: Renderer | None = None

    def reset(
        self, *, seed: Seed = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begins new episodes; see the class for the options.

        Raises:
            TypeError, ValueError: illegal seed, options or task parameters.
        """
        check_options(options, ["task", "reset_mask"])
        mask = _reset_mask(options, self.num_envs)
        if seed is not None:
            seed = generator_seed(seed)
            self.episodes.seed(seed)
        super().reset(seed=seed)
        self.episodes.reset(mask, given_parameters(self.episodes, options))
        return self.episodes.observe().numpy(), self._info()

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Acts once in every episode.

        Raises:
            ValueError: ``actions`` does not have the shape ``[N, A]``.
            RuntimeError: the mode is ``Disabled``, and an episode that is over was not reset.
            SimulationError: some simulations failed; ``partial`` is what would be returned.
        """
        action = torch.tensor(np.asarray(actions))
        over = self.episodes.truncated()
        if over.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(
                f"episode(s) {over.nonzero().flatten().tolist()} are over; in the mode Disabled, "
                "reset them before the next step: reset(options={'reset_mask': terminated | "
                "truncated})"
            )
        reward, failures = self._act(action, over)
        ended, final = self.episodes.truncated(), {}
        if ended.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
            final = self._final(ended.numpy())
            self.episodes.reset(ended)
        observation, info = self.episodes.observe().numpy(), final | self._info()
        terminated = np.zeros(self.num_envs, dtype=bool)
        result = (observation, reward.numpy(), terminated, ended.numpy(), info)
        if failures:
            raise SimulationError(failures, result)
        return result

    def _act(self, action: Tensor, over: Tensor) -> tuple[Tensor, dict[int, str]]:
        """Acts where an episode goes on, and begins a new one where the last one is over."""
        if not over.any():
            return self.episodes.step(action)
        low, _ = self.episodes.task.action_bounds
        check_action(action, (self.num_envs, len(low)))  # before anything happens
        self.episodes.reset(over)
        if over.all():
            return torch.zeros(self.num_envs, dtype=torch.float32), {}
        return self.episodes.step(action, ~over)

    def _info(self) -> dict[str, Any]:
        return _masked_task(self.episodes, np.ones(self.num_envs, dtype=bool))

    def _final(self, ended: Array) -> dict[str, Any]:
        observations = np.full(self.num_envs, None, dtype=object)
        last = self.episodes.observe().numpy()
        for i in np.flatnonzero(ended):  # as gymnasium has them: an array of arrays and None
            observations[i] = last[i]
        info = _masked_task(self.episodes, ended)
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": info,
            "_final_info": ended.copy(),
        }

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


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        legal = [legal.value for legal in AutoresetMode]
        raise ValueError(f"unknown autoreset_mode {mode!r}; expected one of {legal}") from error


def _max_steps(steps: int | None) -> int | None:
    if steps is None or steps == -1:
        return None
    if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 1:
        raise ValueError(
            f"max_episode_steps is {steps!r}; expected a positive integer, or None (or -1) for the "
            "task's own horizon"
        )
    return int(steps)


def _reset_mask(options: Options, num_envs: int) -> Tensor | None:
    """The option ``reset_mask``, under the conditions of gymnasium's own vector environments."""
    if not options or "reset_mask" not in options:
        return None
    mask = options["reset_mask"]
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        kind = f"an array of {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"the reset option 'reset_mask' is {kind}; expected a numpy array of bool")
    if mask.shape != (num_envs,) or not mask.any():
        raise ValueError(
            f"the reset option 'reset_mask' has the shape {mask.shape} and {int(mask.sum())} True "
            f"value(s); expected the shape ({num_envs},) and at least one"
        )
    return torch.from_numpy(mask.copy())


def _masked_task(episodes: Episodes, mask: Array) -> dict[str, Any]:
    """The parameters where the mask is True and zeros elsewhere, as gymnasium batches an info."""
    task: dict[str, Any] = {}
    for name, value in episodes.parameters.items():
        row = mask.reshape(-1, *[1] * (value.ndim - 1))
        task[name] = np.where(row, value.numpy(), np.zeros_like(value.numpy()))
        task[f"_{name}"] = mask.copy()
    return {"task": task, "_task": mask.copy()}
