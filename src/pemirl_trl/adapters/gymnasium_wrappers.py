"""The learned reward in the place of a Gymnasium environment's own.

The reward of a step is r(s_t, m), of the state that the step starts from, as everywhere here. What
trains on Gymnasium environments, such as Stable-Baselines3, then trains on it.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from pemirl_trl.adapters.absorbing_wrapper import AbsorbingStateWrapper
from pemirl_trl.adapters.fixed_context import Context, FixedContext, Reward

TRUE_REWARD = "true_reward"
"""Where a step's ``info`` has the environment's own reward."""


class LearnedRewardWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Give r(s_t, m) for the reward of a single environment; its own goes to ``info``.

    The own reward is ``info["true_reward"]``: a metric, that no learner reads.

    Where the reward knows of ends (``model.absorbing``), what ended goes on where it ended, up to
    T (:class:`AbsorbingStateWrapper`, unless it is there already): r of having ended is collected
    at every step that is left.

    Args:
        env: observes what the demonstrations did.
        reward: a reward, a model that has one, or the file or the zoo's name of either.
        demonstration_or_m: one demonstration of the task, or m ``[D]``.
        observation_key: of an environment whose observation is a dictionary: which entry it is.

    Raises:
        TypeError: ``env`` is a vector environment.
        ValueError: it observes something else; or as
            :class:`pemirl_trl.adapters.fixed_context.FixedContext`.

    Warns:
        FarFromTraining: once, where observations leave what the reward was trained on.

    Example:
        >>> from pemirl_trl import PEMIRLModel
        >>> model = PEMIRLModel(observation_dim=3, action_dim=1, horizon=200)  # yours, trained
        >>> env = LearnedRewardWrapper(gymnasium.make("Pendulum-v1"), model, [0.1, 0.2, 0.3])
        >>> _ = env.reset(seed=0)
        >>> observation, r, terminated, truncated, info = env.step(env.action_space.sample())
        >>> sorted(info)
        ['true_reward']
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        reward: Reward,
        demonstration_or_m: Context,
        *,
        observation_key: str | None = None,
    ) -> None:
        if isinstance(env, VectorEnv):
            raise TypeError(
                "LearnedRewardWrapper takes a single environment; of a vector environment take "
                "LearnedRewardVectorWrapper"
            )
        self._reward = FixedContext(reward, demonstration_or_m)
        self._key = observation_key
        learned = self._reward.reward
        size = _observed_size(env.observation_space, observation_key)
        if learned.config.absorbing and size == learned.observation_dim - 1:
            env = AbsorbingStateWrapper(env, learned.horizon, observation_key=observation_key)
        super().__init__(env)
        _check_space(env.observation_space, observation_key, learned.observation_dim)
        self._state: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        # A copy: an environment may write its next observation to the same memory.
        self._state = np.array(_entry(observation, self._key))
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step, with the learned reward of where the step started."""
        learned = float(self._reward(self._state))
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._state = np.array(_entry(observation, self._key))
        return observation, learned, terminated, truncated, {**info, TRUE_REWARD: float(reward)}


class LearnedRewardVectorWrapper(VectorWrapper):
    """Give r(s_t, m) for the rewards of a vector environment; its own go to ``infos``.

    The own rewards are ``infos["true_reward"]`` ``[N]``. All autoreset modes are served: where a
    step only resets an environment (``NEXT_STEP``), its learned reward is 0, as the environment's.
    A reward that knows of ends takes environments that are each in an
    :class:`AbsorbingStateWrapper`.

    Args:
        env: observes what the demonstrations did.
        reward, demonstration_or_m, observation_key: as of :class:`LearnedRewardWrapper`.

    Raises:
        TypeError: ``env`` is no vector environment.
        ValueError: as of :class:`LearnedRewardWrapper`.

    Warns:
        FarFromTraining: once, where observations leave what the reward was trained on.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        reward: Reward,
        demonstration_or_m: Context,
        *,
        observation_key: str | None = None,
    ) -> None:
        if not isinstance(env, VectorEnv):
            raise TypeError(
                f"LearnedRewardVectorWrapper takes a vector environment, got {type(env).__name__}; "
                "of a single one take LearnedRewardWrapper"
            )
        super().__init__(env)
        self._reward = FixedContext(reward, demonstration_or_m)
        self._key = observation_key
        learned, space = self._reward.reward, env.single_observation_space
        size = learned.observation_dim
        if learned.config.absorbing and _observed_size(space, observation_key) == size - 1:
            raise ValueError(
                "this reward knows of ends, and a vector environment would begin anew after one: "
                f"wrap each single one in AbsorbingStateWrapper(env, {learned.horizon}) before "
                "they are made a vector environment"
            )
        _check_space(space, observation_key, size)
        mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._resets_in_a_step = mode == AutoresetMode.NEXT_STEP
        self._states: NDArray[Any] = np.empty(0)
        self._ended: NDArray[np.bool_] = np.zeros(env.num_envs, dtype=bool)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments, or those that ``options["reset_mask"]`` names."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._states = np.array(_entry(observations, self._key))
        self._ended = np.zeros(self.num_envs, dtype=bool)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, NDArray[Any], Any, Any, dict[str, Any]]:
        """Step, with the learned rewards of where the steps started."""
        learned = self._reward(self._states).double().numpy()
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        if self._resets_in_a_step:
            learned[self._ended] = 0.0
        self._states = np.array(_entry(observations, self._key))
        self._ended = np.logical_or(terminations, truncations)
        return observations, learned, terminations, truncations, {**infos, TRUE_REWARD: rewards}


def _entry(observation: Any, key: str | None) -> Any:
    return observation if key is None else observation[key]


def _observed_size(space: gymnasium.Space[Any], key: str | None) -> int | None:
    """S of an environment that observes a vector; None otherwise."""
    if isinstance(space, gymnasium.spaces.Dict):
        space = space.spaces.get(key or "", space)
    return space.shape[0] if space.shape is not None and len(space.shape) == 1 else None


def _check_space(space: gymnasium.Space[Any], key: str | None, size: int) -> None:
    """Raise ValueError unless a single environment observes ``[S]``."""
    if isinstance(space, gymnasium.spaces.Dict):
        if key not in space.spaces:
            raise ValueError(
                f"the environment observes {sorted(space.spaces)}; got observation_key={key!r}"
            )
        space = space.spaces[key]
    elif key is not None:
        raise ValueError(f"the environment observes no dictionary; got observation_key={key!r}")
    if _observed_size(space, None) != size:
        raise ValueError(
            f"the environment observes {space}; the reward was learned on {size} numbers"
        )
