"""What both environments share: from a task to spaces, and from gymnasium's options to resets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor

from pemirl_envs.episodes import Episodes
from pemirl_envs.tasks import Task

Array = NDArray[Any]
Options = Mapping[str, Any] | None


def task_spaces(task: Task) -> tuple[spaces.Box, spaces.Box]:
    """The spaces of one observation and of one action, float32."""
    low, high = (bound.float().numpy() for bound in task.action_bounds)
    observation = spaces.Box(-np.inf, np.inf, (task.observation_size,), np.float32)
    return observation, spaces.Box(low, high, dtype=np.float32)


def check_render_mode(mode: str | None) -> None:
    """Checks a render mode.

    Raises:
        ValueError: it is neither ``"rgb_array"`` nor None.
    """
    if mode not in (None, "rgb_array"):
        raise ValueError(f"unknown render mode {mode!r}; expected 'rgb_array' or None")


def check_options(options: Options, legal: Sequence[str]) -> None:
    """Checks the names of a reset's options.

    Raises:
        ValueError: one is not legal, or the value of ``task`` is not a mapping.
    """
    unknown = sorted(set(options or {}) - set(legal))
    if unknown:
        raise ValueError(f"unknown reset option(s) {unknown}; expected one of {list(legal)}")
    task = (options or {}).get("task", {})
    if not isinstance(task, Mapping):
        raise ValueError(
            f"the reset option 'task' is {task!r}; expected parameters by name, such as "
            "{'goal': (0.3, 0.5)}"
        )


def given_parameters(episodes: Episodes, options: Options) -> dict[str, Tensor] | None:
    """The option ``task``, one value for each episode or one for all, as ``[N, ...]``."""
    if not options or "task" not in options:
        return None
    num_sims = episodes.simulation.num_sims
    bounds = episodes.task.parameter_bounds
    values = {name: torch.tensor(np.asarray(value)) for name, value in options["task"].items()}
    return {
        name: value.expand(num_sims, *value.shape)
        if name in bounds and value.shape == bounds[name][0].shape
        else value
        for name, value in values.items()
    }
