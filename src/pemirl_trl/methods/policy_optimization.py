"""Policy optimisation with a reward, true or learned: experts, and adaptation (Algorithm 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Any

from pydantic.dataclasses import dataclass
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import EnvBase

from pemirl_trl.configuration import CHECKED, Count, NonNegative, Positive, Share
from pemirl_trl.methods.best_trajectories import BestTrajectories
from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.diagnostics import Diagnostics
from pemirl_trl.methods.observation_statistics import ObservationStatistics
from pemirl_trl.methods.schedule import AnnealedScale
from pemirl_trl.methods.trpo import TRPO, TRPOConfig
from pemirl_trl.modules.model import Policy
from pemirl_trl.transforms import LearnedReward


@dataclass(frozen=True, config=CHECKED)
class PolicyOptimizationConfig:
    """Of a policy trained from scratch on a fixed reward.

    Attributes:
        iterations: policy steps.
        trpo: of one step.
        final_scale: if given, the deviation is not learned but forced, log-linearly from the
            policy's initial one to this; so is the uniform share of discrete actions.
        anneal_begin, anneal_finish: shares of the iterations between which it moves.
        imitate_best: weight, beside standardised advantages, of the squared error to the actions of
            the best trajectory that any task's policy has found for each task; needs a reward that
            is known as a function (see :class:`BestTrajectories`). 0 is off.
        standardize_observations: whether the policy's map of observations follows the mean and
            deviation of all that it has seen, after each step; otherwise it stays as it is.
    """

    iterations: Count = 100
    trpo: TRPOConfig = field(default_factory=TRPOConfig)
    final_scale: Positive | None = None
    anneal_begin: Share = 0.0
    anneal_finish: Share = 0.8
    imitate_best: NonNegative = 0.0
    standardize_observations: bool = False

    @classmethod
    def adaptation(cls) -> PolicyOptimizationConfig:
        """Algorithm 2's, as published for Point-Maze: explore widely, then precisely.

        Advantages are standardised per task, so that none outweighs the others.
        """
        return cls(
            iterations=72,
            trpo=TRPOConfig(gamma=1.0, standardize="context"),
            final_scale=0.1,
            imitate_best=1.0,
        )


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
        diagnostics: measure each iteration's rollouts, for :class:`pemirl_trl.Health`.

    Raises:
        ValueError: ``imitate_best`` without a reward: the environment's own is known only for the
            task that a trajectory was collected for.
    """

    def __init__(
        self,
        env: EnvBase,
        policy: Policy,
        horizon: int,
        config: PolicyOptimizationConfig,
        *,
        rollouts_per_context: int,
        reward: TensorDictModuleBase | None = None,
        task_keys: Sequence[NestedKey] = ("context",),
        diagnostics: Diagnostics | None = None,
    ) -> None:
        self.config, self.policy, self._diagnostics = config, policy, diagnostics
        self.iterations = config.iterations
        self._collect = EpisodeCollector(env, policy, horizon)
        stretch = (config.anneal_begin, config.anneal_finish)
        self._scale = AnnealedScale(policy.log_scale, config.final_scale, *stretch)
        self._update = TRPO(policy, config.trpo, rollouts_per_context)
        self._learned = None if reward is None else LearnedReward(reward)
        self._statistics: ObservationStatistics | None = None
        if config.standardize_observations:
            self._statistics = ObservationStatistics(policy.standardize)
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
        self._scale.move(self._collect.progress(self.iterations))
        rollouts = self._collect()
        metrics = self._collect.true_return(rollouts)
        if self._learned is not None:
            self._learned(rollouts)
            metrics["return/learned"] = float(rollouts["next", "reward"].sum(1).mean())
        if self._diagnostics is not None:
            metrics |= self._diagnostics(rollouts, rollouts["next", "reward"])
        imitation = None
        if self._best is not None:
            metrics |= self._best.update(rollouts)
            imitation = self._best.loss(self.policy, self.config.imitate_best)
        metrics |= self._update(rollouts, imitation)
        if self._statistics is not None:  # after the step, whose old densities are of the old map
            self._statistics.update(rollouts["observation"])
        return metrics

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        best = {} if self._best is None else {"best": self._best}
        seen = {} if self._statistics is None else {"observations": self._statistics}
        return {"policy": self.policy, "collector": self._collect, **best, **seen}
