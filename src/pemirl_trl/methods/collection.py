"""Whole episodes ``[N, T]`` from a batched environment, a fresh reset each time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from copy import deepcopy
from typing import Any, TypeVar

import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from pemirl_trl.methods.requirements import check_environment
from pemirl_trl.methods.sampling import GaussianSampler, sampler_of
from pemirl_trl.modules.model import Policy
from pemirl_trl.modules.network import device_of
from pemirl_trl.transforms import InferContext

Transformed = TypeVar("Transformed", bound=Transform)


class Collection(ABC):
    """Rollouts ``[N, T]`` of whole episodes, one batch a call, and what a training asks of them.

    Args:
        frames: environment steps of a batch.
        knows_tasks: whether the environment is reset to the demonstrated tasks.

    Attributes:
        env_steps: environment steps collected so far, in all.
    """

    def __init__(self, *, frames: int, knows_tasks: bool) -> None:
        self.frames, self.knows_tasks = frames, knows_tasks
        self.env_steps = 0

    @abstractmethod
    def _batch(self) -> TensorDictBase:
        """Collect one batch."""

    def __call__(self) -> TensorDictBase:
        """Collect rollouts ``[N, T]``; raise ValueError if they are not whole episodes."""
        rollouts = self._batch()
        self.env_steps += self.frames
        return rollouts

    def true_return(self, rollouts: TensorDictBase) -> dict[str, float]:
        """``return/true``: the mean return of rollouts ``[N, T]`` on the environment's own reward.

        Empty where the environment was not reset to the demonstrated tasks: without ground truth
        its reward is that of some other task.
        """
        if not self.knows_tasks:
            return {}
        return {"return/true": float(rollouts["next", "reward"].sum(1).mean())}

    def progress(self, iterations: int) -> float:
        """Where the next of so many iterations stands, from 0 for the first to 1 for the last."""
        return self.env_steps // self.frames / max(1, iterations - 1)

    def state_dict(self) -> dict[str, Any]:
        """The steps."""
        return {"env_steps": self.env_steps}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take that state back."""
        self.env_steps = int(state["env_steps"])


class EpisodeCollector(Collection):
    """A TorchRL collector that yields one whole episode per environment and iteration.

    Args:
        env: batch size ``[N]``; all its episodes last ``horizon`` steps.
        policy: sampled, and seen live: steps on its parameters count at once. Where it is on
            another device than the environment, a copy of it acts, with the weights of the moment,
            and rollouts come to its device as a whole.
        horizon: T.

    Raises:
        ValueError: the environment is not one that the policy can act in.
    """

    def __init__(self, env: EnvBase, policy: Policy, horizon: int) -> None:
        check_environment(env, policy, horizon)
        super().__init__(
            frames=env.batch_size[0] * horizon,
            knows_tasks=all(t.knows_tasks for t in _transforms(env, InferContext)),
        )
        self.horizon = horizon
        self.env, self._learner, self._device = env, policy, device_of(policy)
        here = env.device or torch.device("cpu")
        self._policy = policy if self._device == here else deepcopy(policy).to(here)
        self._sampler = sampler_of(self._policy)
        self._collector = Collector(
            env,
            self._sampler,
            frames_per_batch=self.frames,
            total_frames=-1,
            device=env.device,  # said outright, it saves a copy of every step's data
            reset_at_each_iter=True,
            auto_register_policy_transforms=False,
            track_traj_ids=False,
        )
        self._batches: Iterator[TensorDictBase] = iter(self._collector)

    def _batch(self) -> TensorDictBase:
        """One batch.

        Where a step begins in an absorbing state, the action is set to 0, since none was taken, and
        its log-density to minus the policy's entropy: what the policy's own draw has on average.
        """
        if self._policy is not self._learner:
            self._policy.load_state_dict(self._learner.state_dict())
        rollouts = next(self._batches)
        if isinstance(self._sampler, GaussianSampler):
            self._sampler.complete(rollouts)
        done = rollouts.get(("next", "done"))
        if rollouts.shape[-1] != self.horizon or done[:, :-1].any() or not done[:, -1].all():
            raise ValueError(
                f"expected episodes that all end at step {self.horizon}, got ends at steps "
                f"{sorted((done.squeeze(-1).nonzero()[:, 1] + 1).unique().tolist())}. Episodes "
                "that end by themselves need AbsorbingState and a model that knows of ends "
                "(model.absorbing=true); a time limit is that of the demonstrations"
            )
        if not bool(torch.isfinite(rollouts["next", "observation"]).all()):
            raise ValueError(
                "the environment observed NaN or infinity, after "
                f"{self.env_steps:,} steps without: what it does with the actions that the policy "
                "took is not defined (clamp actions or states in it, or take smaller time steps)"
            )
        if "absorbing" in rollouts and rollouts["absorbing"].any():
            _settle(rollouts, self._policy)
        return rollouts if self._policy is self._learner else rollouts.to(self._device)

    def state_dict(self) -> dict[str, Any]:
        """The steps, and the environment's random state where it tells it (``get_rng_state``)."""
        base = _unwrapped(self.env)
        rng = {"rng": base.get_rng_state()} if hasattr(base, "get_rng_state") else {}
        return {**super().state_dict(), **rng}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take that state back."""
        super().load_state_dict(state)
        if "rng" in state:
            _unwrapped(self.env).set_rng_state(state["rng"])


def collection(env: EnvBase | Collection, policy: Policy, horizon: int) -> Collection:
    """What collects a policy's episodes: an :class:`EpisodeCollector`, unless it is given."""
    return env if isinstance(env, Collection) else EpisodeCollector(env, policy, horizon)


@torch.no_grad()
def _settle(rollouts: TensorDictBase, policy: Policy) -> None:
    """Let steps that begin in an absorbing state look alike, whoever's they are."""
    absorbing = rollouts["absorbing"]
    rollouts["action"][absorbing] = 0
    inputs = rollouts.select(*policy.in_keys)[absorbing]
    rollouts["action_log_prob"][absorbing] = -policy.get_dist(inputs).entropy()


def _transforms(env: EnvBase, kind: type[Transformed]) -> Iterator[Transformed]:
    """The transforms of a kind, of an environment that may be wrapped several times."""
    while isinstance(env, TransformedEnv):
        transform = env.transform
        each = transform.transforms if isinstance(transform, Compose) else [transform]
        yield from (t for t in each if isinstance(t, kind))
        env = env.base_env


def _unwrapped(env: EnvBase) -> Any:
    while isinstance(env, TransformedEnv):
        env = env.base_env
    return env
