"""What ``training.py`` and ``growth.py`` measure: methods that keep the time of their parts."""

from __future__ import annotations

import dataclasses
import resource
import sys
import time
from collections.abc import Callable
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from pemirl_envs import get_task, make, task_parameters
from pemirl_trl import InferContext, PEMIRLModel, Standardize
from pemirl_trl.methods import (
    METHODS,
    PEMIRL,
    AdaptationConfig,
    PEMIRLConfig,
    PolicyOptimization,
)
from pemirl_trl.methods.adaptation import initial_policy

CONTEXTS = 50  # per iteration of meta-training, as in the paper
ROLLOUTS = (8, 16)  # per context: this project's default, and the authors' code's
TORCH_THREADS = 2  # beside one, which is what published results were made with
DEMONSTRATIONS = 100  # among which contexts are drawn
TASKS = 10  # of an adaptation, which share its rollouts
TRAINED = [name for name, method in METHODS.items() if isinstance(method.training, PEMIRLConfig)]

Seconds = dict[str, float]


class Timed(Protocol):
    """A method that keeps the seconds of its parts, and the actions, of its last iteration."""

    seconds: Seconds
    actions: Tensor  # [N, T, A]

    def iteration(self) -> dict[str, float]:
        """One iteration."""


class TimedPEMIRL(PEMIRL):
    """Meta-training that keeps the time of its parts, and its actions."""

    seconds: Seconds
    actions: Tensor
    _updated: tuple[float, float]  # when encoder and reward began and finished

    def iteration(self) -> dict[str, float]:
        """One iteration; ``seconds`` holds the parts of the last one."""
        start = time.perf_counter()
        metrics = super().iteration()
        end = time.perf_counter()
        began, finished = self._updated
        self.seconds = {
            "encoder and reward": finished - began,
            "policy": end - finished,
            "collection": began - start,
        }
        return metrics

    def _update_encoder_and_reward(self, rollouts: TensorDictBase) -> dict[str, float]:
        self.actions = rollouts["action"]
        began = time.perf_counter()
        metrics = super()._update_encoder_and_reward(rollouts)
        self._updated = began, time.perf_counter()
        return metrics


class TimedAdaptation(PolicyOptimization):
    """Adaptation that keeps the time of its parts, and its actions."""

    seconds: Seconds
    actions: Tensor
    _in_policy: float  # seconds

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._untimed, self._update = self._update, self._timed  # type: ignore[assignment]

    def iteration(self) -> dict[str, float]:
        """One iteration; ``seconds`` holds the parts of the last one."""
        start = time.perf_counter()
        metrics = super().iteration()
        rest = time.perf_counter() - start - self._in_policy
        self.seconds = {"collection and scores": rest, "policy": self._in_policy}
        return metrics

    def _timed(
        self, rollouts: TensorDictBase, extra_loss: Callable[[], Tensor] | None
    ) -> dict[str, float]:
        self.actions = rollouts["action"]
        began = time.perf_counter()
        metrics = self._untimed(rollouts, extra_loss)
        self._in_policy = time.perf_counter() - began
        return metrics


def random_demonstrations(name: str, count: int, horizon: int) -> TensorDictBase:
    """Rollouts of random actions: the work of an iteration does not depend on who acts."""
    env = make(name, count, seed=0)
    keys = ("observation", "action", ("next", "observation"))
    rollouts = env.rollout(horizon).select(*keys)
    rollouts.batch_size = [count]
    return rollouts


def untrained_model(name: str, method: str, experts: TensorDictBase) -> PEMIRLModel:
    """The networks of a method, for trajectories ``[J]`` of a task."""
    config = METHODS[method]
    settings = config.model
    if config.reward_reads == "task_space":
        settings = dataclasses.replace(
            settings, reward_features=get_task(name).task_space_indices()
        )
    observation, action = experts["observation"], experts["action"]
    model = PEMIRLModel(
        observation.shape[-1],
        action.shape[-1],
        action.shape[1],
        settings,
        Standardize.fit(observation),
    )
    model.policy.log_scale.requires_grad_(config.learn_policy_scale)
    return model


def meta_training(setting: Setting, name: str, method: str, num_threads: int) -> TimedPEMIRL:
    """Meta-training after its first iteration."""
    tasks = task_parameters(name, get_task(name).default_split)[:DEMONSTRATIONS]
    experts = random_demonstrations(name, len(tasks), setting.steps(name))
    model = untrained_model(name, method, experts)
    k = setting.rollouts
    env = make(name, setting.simulations, seed=0, num_threads=num_threads)
    env.episodes.max_steps = model.horizon
    context = InferContext(model.encoder, experts, rollouts_per_context=k, tasks=tasks)
    config = METHODS[method].training
    if not isinstance(config, PEMIRLConfig):
        raise ValueError(f"{method!r} is not measured; expected one of {TRAINED}")
    config = dataclasses.replace(config, rollouts_per_context=k)
    training = TimedPEMIRL(model, TransformedEnv(env, context), experts, config)
    training.iteration()
    return training


def adaptation(setting: Setting, name: str, method: str, num_threads: int) -> TimedAdaptation:
    """Adaptation to a learned reward, with the library's defaults, after its first iteration."""
    experts = random_demonstrations(name, setting.contexts, setting.steps(name))
    model = untrained_model(name, method, experts)
    env = make(name, setting.simulations, seed=0, num_threads=num_threads)
    context = InferContext(model.encoder, experts, rollouts_per_context=setting.rollouts)
    config = AdaptationConfig()
    policy, _ = initial_policy(model, config)
    training = TimedAdaptation(
        TransformedEnv(env, context),
        policy,
        model.horizon,
        config.optimization,
        rollouts_per_context=setting.rollouts,
        reward=model.reward,
    )
    training.iteration()
    return training


@dataclasses.dataclass(frozen=True)
class Setting:
    """Something that is measured: who trains, and on how many rollouts of how many contexts."""

    kind: str
    contexts: int
    rollouts: int
    begin: Callable[[Setting, str, str, int], Timed]
    torch_threads: int = 1
    horizon: int | None = None  # the task's, unless meta-training is given a shorter one

    def steps(self, name: str) -> int:
        """How long an episode is."""
        return self.horizon or get_task(name).horizon

    @property
    def simulations(self) -> int:
        """How many step at once."""
        return self.contexts * self.rollouts

    @property
    def title(self) -> str:
        """Its name in tables."""
        threads = "" if self.torch_threads == 1 else f", {self.torch_threads} torch threads"
        return f"{self.kind}, {self.contexts} x {self.rollouts}{threads}"

    @property
    def engine(self) -> str:
        """The name of the raw engine that it is compared with."""
        return f"raw engine, {self.simulations}"

    def start(self, name: str, method: str, num_threads: int) -> Timed:
        """The training of a task, after its first iteration."""
        torch.set_num_threads(self.torch_threads)
        return self.begin(self, name, method, num_threads)


SETTINGS = (
    *(Setting("meta-training", CONTEXTS, k, meta_training) for k in ROLLOUTS),
    Setting("meta-training", CONTEXTS, ROLLOUTS[-1], meta_training, TORCH_THREADS),
    Setting("adaptation", TASKS, AdaptationConfig().rollouts // TASKS, adaptation),
)


def peak_memory(setting: Setting, name: str, method: str, num_threads: int) -> int:
    """MiB that a process needs at most for two iterations; to be called in a fresh one."""
    setting.start(name, method, num_threads).iteration()
    return peak_memory_mib()


def peak_memory_mib() -> int:
    """What this process has needed at most."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (2**20 if sys.platform == "darwin" else 2**10))  # bytes, or KiB
