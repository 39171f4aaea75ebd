"""Environments of whole episodes from whatever a user's ``make_env`` returns."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from torch import Tensor
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import (
    Compose,
    DoubleToFloat,
    EnvBase,
    GymWrapper,
    RenameTransform,
    StepCounter,
    Transform,
    TransformedEnv,
)
from torchrl.modules import RandomPolicy

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.data.doctor import examine_actions
from pemirl_trl.methods.requirements import check_environment, check_episodes
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.family import FAR
from pemirl_trl.transforms import (
    AbsorbingState,
    InferContext,
    JoinObservations,
    OneHotActions,
)

LOG = logging.getLogger("pemirl_trl")
MakeEnv = Callable[[int, int], Any]
"""(num_envs, seed) -> a TorchRL environment of batch size ``[num_envs]``, a Gymnasium vector
environment of as many, or a single Gymnasium environment, which is then made for each of them."""

_PROBED = 2  # environments of the episode that is looked at before anything is trained


class Episodes:
    """Makes environments whose episodes last as long as the longest demonstration did.

    One episode of random actions is looked at first. An environment without a time limit of its
    own is given one; where the model knows of ends, episodes that end by themselves go on to the
    horizon in absorbing states. An environment that ends otherwise is refused.

    Args:
        make_env: see :data:`MakeEnv`.
        model: whose policy is to act.
        demonstrations: give the horizon.
        seed: of the episode that is looked at.
        observation_keys: which entries of what it observes make the observation, in this order;
            None: its ``"observation"`` is it. See :class:`pemirl_trl.JoinObservations`.

    Raises:
        TypeError: ``make_env`` returns something else than an environment.
        ValueError: everything about the environment that does not fit, each with its cure.
    """

    def __init__(
        self,
        make_env: MakeEnv,
        model: PEMIRLModel,
        demonstrations: DemonstrationDataset,
        seed: int = 0,
        *,
        observation_keys: Sequence[str] | None = None,
    ) -> None:
        check_signature(make_env)
        self._make_env, self._horizon = make_env, model.horizon
        self._absorbing = model.config.absorbing
        self._observation_keys = observation_keys
        with torch.random.fork_rng(devices=[]):
            env = self._whole(_PROBED, seed)
            infer = InferContext(model.encoder, demonstrations.trajectories())
            check_environment(_transformed(env, infer), model.policy, model.horizon)
            _warn_of_actions(env, demonstrations)
            actor = RandomPolicy(env.action_spec)
            rollouts = env.rollout(model.horizon, actor, break_when_any_done=False)
            _warn_of_starts(rollouts["observation"][:, 0], demonstrations, model)
            self._limited = check_episodes(rollouts, model.horizon, absorbing=self._absorbing)
            env.close(raise_if_closed=False)

    def __call__(self, num_envs: int, seed: int, transform: Transform) -> EnvBase:
        """Make ``num_envs`` environments, with a transform that decides what is rolled out."""
        limit = [] if self._limited else [StepCounter(self._horizon)]
        return _transformed(self._whole(num_envs, seed), Compose(*limit, transform))

    def _whole(self, num_envs: int, seed: int) -> EnvBase:
        env = _batched(self._make_env, num_envs, seed, self._horizon, self._observation_keys)
        return _transformed(env, AbsorbingState()) if self._absorbing else env


def _warn_of_starts(
    starts: Tensor, demonstrations: DemonstrationDataset, model: PEMIRLModel
) -> None:
    """Log starts ``[N, S]`` that are far from where demonstrations began."""
    shown = demonstrations.observation[:, 0]
    beyond = torch.maximum(shown.amin(0) - starts, starts - shown.amax(0)).clamp(min=0)
    excess = (beyond / model.standardize.scale).amax(0)
    if float(excess.max()) > FAR:
        LOG.warning(
            "episodes begin up to %.0f deviations outside of where demonstrations did (component "
            "%d of the observation): is this their environment, in their units?",
            float(excess.max()),
            int(excess.argmax()),
        )


def check_signature(make_env: Callable[..., Any], name: str = "make_env") -> None:
    """Raise TypeError unless it can be called with a number and a seed; ``name`` is for that."""
    try:
        inspect.signature(make_env).bind(1, 0)
    except TypeError as error:
        raise TypeError(f"{error}; it is called as {name}(num_envs, seed)") from error


def _warn_of_actions(env: EnvBase, demonstrations: DemonstrationDataset) -> None:
    """Log demonstrated actions that are far from what the environment takes, if it says what."""
    box = env.action_spec.space
    if not isinstance(box, ContinuousBox) or demonstrations.action_dim == 0:
        return
    low, high = box.low[0], box.high[0]
    if bool((low.isfinite() & high.isfinite() & (low < high)).all()):
        for finding in examine_actions(demonstrations, (low.float(), high.float())):
            LOG.warning("%s", finding)


def ends_early(
    make_env: MakeEnv, horizon: int, seed: int, observation_keys: Sequence[str] | None = None
) -> bool:
    """Whether an episode of random actions ends by itself (``terminated``) before ``horizon``."""
    with torch.random.fork_rng(devices=[]):
        env = _batched(make_env, _PROBED, seed, horizon, observation_keys)
        rollouts = env.rollout(horizon, RandomPolicy(env.action_spec), break_when_any_done=False)
        env.close(raise_if_closed=False)
    terminated = rollouts.get(("next", "terminated"), None)
    return terminated is not None and bool(terminated[:, : horizon - 1].any())


def _batched(
    make_env: MakeEnv,
    num_envs: int,
    seed: int,
    horizon: int,
    observation_keys: Sequence[str] | None,
) -> EnvBase:
    env = _torchrl(make_env, num_envs, seed, horizon)
    if tuple(env.batch_size) != (num_envs,):
        raise ValueError(
            f"make_env({num_envs}, {seed}) returned an environment of batch size "
            f"{list(env.batch_size)}; expected [{num_envs}]"
        )
    if observation_keys is not None:
        env = _transformed(env, JoinObservations(observation_keys, env))
    one_hot = OneHotActions.of(env)
    return _single_precision(env if one_hot is None else _transformed(env, one_hot))


def _torchrl(make_env: MakeEnv, num_envs: int, seed: int, horizon: int) -> EnvBase:
    made = make_env(num_envs, seed)
    if isinstance(made, gymnasium.Env):
        others = [make_env(1, seed + i) for i in range(1, num_envs)]
        makers = [lambda env=env: env for env in (made, *others)]
        made = SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED)
    if isinstance(made, VectorEnv):
        _check_time_limit(made, horizon)
        made = wrap_gymnasium(made)
        made.set_seed(seed)
    if not isinstance(made, EnvBase):
        raise TypeError(
            f"make_env({num_envs}, {seed}) returned a {type(made).__name__}; expected a "
            "TorchRL environment (EnvBase), a Gymnasium vector environment or a single one"
        )
    return made


def wrap_gymnasium(env: VectorEnv, observation_key: str = "observation") -> EnvBase:
    """Wrap a Gymnasium vector environment in TorchRL, its observation under ``"observation"``.

    Args:
        env: of a fixed number of environments; TorchRL knows the autoreset modes ``DISABLED`` and
            ``SAME_STEP``.
        observation_key: of an observation that is a dictionary: which entry is the observation.

    Raises:
        ValueError: another autoreset mode, no such entry, or discrete actions that are not counted
            from 0.
    """
    first = getattr(env.single_action_space, "start", 0)
    if isinstance(env.single_action_space, gymnasium.spaces.Discrete) and first != 0:
        raise ValueError(
            f"the environment's actions are {env.single_action_space}, and TorchRL counts from 0: "
            f"wrap it, gymnasium.wrappers.TransformAction(env, lambda action: action + {first}, "
            f"gymnasium.spaces.Discrete({env.single_action_space.n}))"
        )
    mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
    if mode not in (AutoresetMode.DISABLED, AutoresetMode.SAME_STEP):
        raise ValueError(
            f"the vector environment's autoreset mode is {mode.name}; expected DISABLED (or "
            "SAME_STEP): gymnasium.make_vec(..., vector_kwargs={'autoreset_mode': "
            "gymnasium.vector.AutoresetMode.DISABLED})"
        )
    wrapped = GymWrapper(_GoOn(env) if mode == AutoresetMode.DISABLED else env)
    if observation_key in ("observation", "state"):  # TorchRL itself takes "state" for it
        return wrapped
    there = [str(key) for key in wrapped.observation_spec]
    if observation_key not in there:
        raise ValueError(f"the environment observes {there}; got observation_key={observation_key}")
    return _transformed(wrapped, RenameTransform([observation_key], ["observation"]))


class _GoOn(VectorWrapper):
    """Resets what has ended and is nevertheless stepped.

    Gymnasium refuses or warns; :class:`pemirl_trl.AbsorbingState` never resets before T, and does
    not look at what has ended.
    """

    def __init__(self, env: VectorEnv) -> None:
        super().__init__(env)
        self.autoreset_mode = AutoresetMode.DISABLED  # TorchRL asks for it
        self._ended = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments of ``options["reset_mask"]``; all without one."""
        mask = None if options is None else options.get("reset_mask")
        self._ended &= False if mask is None else ~mask
        return self.env.reset(seed=seed, options=options)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all of them, after a reset of those that have ended."""
        if self._ended.any():
            self.env.reset(options={"reset_mask": self._ended})
        result = self.env.step(actions)
        self._ended = result[2] | result[3]
        return result


def _check_time_limit(env: VectorEnv, horizon: int) -> None:
    """Raise ValueError where the time limit of Gymnasium's registry is another than ``horizon``."""
    of_each = getattr(env, "get_attr", None)
    if of_each is None:  # not made of single environments
        return
    specs = [spec for spec in of_each("spec") if spec is not None]
    limits = {spec.max_episode_steps for spec in specs} - {None}
    if limits - {horizon}:
        raise ValueError(
            f"the environment's time limit is {sorted(limits)} steps, and the demonstrations have "
            f"{horizon}: give gymnasium.make(..., max_episode_steps={horizon})"
        )


def _single_precision(env: EnvBase) -> EnvBase:
    """Cast float64 observations and actions, as Gymnasium's engines have them."""
    if torch.get_default_dtype() != torch.float32:
        return env
    spec = env.observation_spec.get("observation", None)
    seen = ["observation"] if spec is not None and spec.dtype == torch.float64 else []
    acts = ["action"] if env.action_spec.dtype == torch.float64 else []
    if not seen and not acts:
        return env
    return _transformed(env, DoubleToFloat(in_keys=seen, in_keys_inv=acts))


def _transformed(env: EnvBase, transform: Transform) -> TransformedEnv:
    """Add a transform; one that a user's environment already has stays inside, as it is."""
    return TransformedEnv(env, transform, auto_unwrap=False)
