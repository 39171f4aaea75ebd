"""Policy optimisation with a reward, true or learned: experts, and adaptation (Algorithm 2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.policy_step import PolicyStep, TRPOConfig
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
    """

    iterations: int = 100
    trpo: TRPOConfig = field(default_factory=TRPOConfig)
    final_scale: float | None = None
    anneal_fraction: float = 0.8


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
    ) -> None:
        self.config, self.policy = config, policy
        self.iterations = config.iterations
        self.env_steps = 0
        self._collect = EpisodeCollector(env, policy, horizon)
        self._initial_log_scale = policy.log_scale.detach().clone()
        if config.final_scale is not None:
            policy.log_scale.requires_grad_(False)
        self._step = PolicyStep(policy, config.trpo, rollouts_per_context)
        self._learned = None if reward is None else LearnedReward(reward)
        self._iteration = 0

    def iteration(self) -> dict[str, float]:
        """Collect, score, step."""
        self._force_scale()
        rollouts = self._collect()
        metrics = {"return/true": float(rollouts["next", "reward"].sum(1).mean())}
        if self._learned is not None:
            self._learned(rollouts)
            metrics["return/learned"] = float(rollouts["next", "reward"].sum(1).mean())
        metrics |= self._step(rollouts)
        self._iteration += 1
        self.env_steps += self._collect.frames
        return metrics

    def _force_scale(self) -> None:
        if self.config.final_scale is None:
            return
        steps = max(1, round(self.config.anneal_fraction * self.iterations))
        progress = min(1.0, self._iteration / steps)
        start = self._initial_log_scale
        end = start.new_tensor(self.config.final_scale).log()
        self.policy.log_scale.data.copy_(start + progress * (end - start))

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {"policy": self.policy, "collector": self._collect, "progress": self}

    def state_dict(self) -> dict[str, Any]:
        """Counters of the run."""
        return {
            "iteration": self._iteration,
            "env_steps": self.env_steps,
            "initial_log_scale": self._initial_log_scale,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue a run."""
        self._iteration, self.env_steps = int(state["iteration"]), int(state["env_steps"])
        self._initial_log_scale = state["initial_log_scale"]
