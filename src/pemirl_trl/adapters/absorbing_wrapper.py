"""Gymnasium environments that end early, continued to T in absorbing states."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from numpy.typing import NDArray


class AbsorbingStateWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Let an episode that ends by itself go on to T where it ended, as r was learned there.

    :class:`pemirl_trl.AbsorbingState` for Gymnasium: the observation gets one component more, an
    indicator; once the environment says ``terminated`` the observation stays that of the end with
    an indicator of 1, whatever the actions, and the own reward is 0; ``truncated`` comes at T. An
    environment that says ``truncated`` before is cut there.

    Args:
        env: observes a vector, or a dictionary with one.
        horizon: T, that of the reward.
        observation_key: which entry of a dictionary gets the indicator.

    Raises:
        ValueError: the observation is no vector.

    Example:
        >>> env = AbsorbingStateWrapper(gymnasium.make("CartPole-v1"), horizon=60)
        >>> env.observation_space.shape
        (5,)
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], horizon: int, *, observation_key: str | None = None
    ) -> None:
        super().__init__(env)
        self.horizon, self._key = horizon, observation_key
        space = env.observation_space
        if isinstance(space, Dict) and observation_key in space.spaces:
            inner = {**space.spaces, observation_key: _with_indicator(space[observation_key])}
            self.observation_space = Dict(inner)
        else:
            self.observation_space = _with_indicator(space)
        self._steps, self._end = 0, None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._steps, self._end = 0, None
        return self._told(observation, ended=False), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step, or stay where the episode ended."""
        self._steps += 1
        over = self._steps >= self.horizon
        if self._end is not None:
            return self._end, 0.0, False, over, {}
        observation, reward, terminated, truncated, info = self.env.step(action)
        told = self._told(observation, ended=terminated)
        if terminated:
            self._end, truncated = told, False
        return told, float(reward), False, truncated or over, info

    def _told(self, observation: Any, *, ended: bool) -> Any:
        """The observation with its indicator, in memory of its own."""
        if self._key is None:
            return _append(observation, ended)
        return {**observation, self._key: _append(observation[self._key], ended)}


def _append(values: NDArray[Any], indicator: float) -> NDArray[Any]:
    return np.append(values, np.asarray(indicator, dtype=values.dtype))


def _with_indicator(space: gymnasium.Space[Any]) -> Box:
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise ValueError(f"the environment observes {space}; expected a vector, Box of shape [S]")
    dtype: Any = space.dtype
    return Box(_append(space.low, 0.0), _append(space.high, 1.0), dtype=dtype)
