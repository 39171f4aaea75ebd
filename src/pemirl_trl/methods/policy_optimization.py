"""Policy optimisation with a reward, true or learned: experts, and adaptation (Algorithm 2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import EnvBase

from pemirl_trl.methods.best_trajectories import BestTrajectories
from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.observation_statistics import ObservationStatistics
from pemirl_trl.methods.policy_step import PolicyStep, TRPOConfig
from pemirl_trl.methods.schedule import log_linear
from pemirl_trl.modules import ContextPolicy
from pemirl_trl.transforms import LearnedReward


@dataclass(frozen=True)
class PolicyOptimizationConfig:
    """Of a policy trained from scratch on a fixed reward.

    Attributes:
        iterations: policy steps.
        trpo: of one step.
        final_scale: if given, the deviation is not learned but forced, log-linearly from the
            policy's initial one to this, over ``anneal_fraction`` of the iterations.
        anneal_fraction: see ``final_scale``.
        imitate_best: weight, beside standardised advantages, of the squared error to the actions of
            the best trajectory that any task's policy has found for each task; needs a reward that
            is known as a function (see :class:`BestTrajectories`). 0 is off.
        standardize_observations: whether the policy's map of observations follows the mean and
            deviation of all that it has seen, after each step; otherwise it stays as it is.
    """

    iterations: int = 100
    trpo: TRPOConfig = field(default_factory=TRPOConfig)
    final_scale: float | None = None
    anneal_fraction: float = 0.8
    imitate_best: float = 0.0
    standardize_observations: bool = False


class PolicyOptimization:
    """TRPO on the environment's reward, or on a learned one.

    An expert is this with the true reward and a policy that reads the task; reward adaptation is
    this with the learned reward and a policy that reads the context (Yu et al., 2019, Algorithm 2).

    Args:
        env: batch size ``[N]``, whole episodes of ``horizon`` steps; writes what the policy reads.
        policy: trained in place.
        horizon: T.
        config: of the optimisation.
        rollouts_per_context: consecutive environments that share a task.
        reward: writes ``learned_reward``; None trains on the environment's own.
        task_keys: what distinguishes tasks, for ``imitate_best``: what reward and policy read
            beside observations and actions.

    Raises:
        ValueError: ``imitate_best`` without a reward: the environment's own is known only for the
            task that a trajectory was collected for.
    """

    def __init__(
        self,
        env: EnvBase,
        policy: ContextPolicy,
        horizon: int,
        config: PolicyOptimizationConfig,
        *,
        rollouts_per_context: int,
        reward: TensorDictModuleBase | None = None,
        task_keys: Sequence[NestedKey] = ("context",),
    ) -> None:
        self.config, self.policy = config, policy
        self.iterations = config.iterations
        self._collect = EpisodeCollector(env, policy, horizon)
        self._initial_scale = float(policy.log_scale.detach().exp().mean())
        if config.final_scale is not None:
            policy.log_scale.requires_grad_(False)
        self._step = PolicyStep(policy, config.trpo, rollouts_per_context)
        self._learned = None if reward is None else LearnedReward(reward)
        self._statistics: ObservationStatistics | None = None
        if config.standardize_observations:
            self._statistics = ObservationStatistics(policy.gaussian.standardize)
        self._best: BestTrajectories | None = None
        if config.imitate_best > 0:
            if reward is None:
                raise ValueError(
                    f"imitate_best={config.imitate_best} needs a reward that scores any task"
                )
            space = env.action_spec.space
            bounds = (space.low[0], space.high[0]) if isinstance(space, ContinuousBox) else None
            self._best = BestTrajectories(reward, rollouts_per_context, bounds, task_keys=task_keys)

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self._collect.env_steps

    def iteration(self) -> dict[str, float]:
        """Collect, score, step."""
        self._force_scale()
        rollouts = self._collect()
        metrics = {"return/true": float(rollouts["next", "reward"].sum(1).mean())}
        if self._learned is not None:
            self._learned(rollouts)
            metrics["return/learned"] = float(rollouts["next", "reward"].sum(1).mean())
        imitation = None
        if self._best is not None:
            metrics |= self._best.update(rollouts)
            imitation = self._best.loss(self.policy, self.config.imitate_best)
        metrics |= self._step(rollouts, imitation)
        if self._statistics is not None:  # after the step, whose old densities are of the old map
            self._statistics.update(rollouts["observation"])
        return metrics

    def _force_scale(self) -> None:
        if self.config.final_scale is None:
            return
        progress = self._collect.progress(self.iterations)
        finish = self.config.anneal_fraction
        scale = log_linear(self._initial_scale, self.config.final_scale, progress, finish=finish)
        self.policy.log_scale.data.fill_(math.log(scale))

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        best = {} if self._best is None else {"best": self._best}
        seen = {} if self._statistics is None else {"observations": self._statistics}
        return {"policy": self.policy, "collector": self._collect, **best, **seen}
