"""Training policies on learned rewards, and comparing what they earn under them."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data.tensor_specs import ContinuousBox

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.evaluation import whole_episodes
from pemirl_trl.methods.adaptation import AdaptationConfig, initial_policy, objective
from pemirl_trl.methods.diagnostics import Diagnostics
from pemirl_trl.methods.environments import Episodes
from pemirl_trl.methods.inference import infer
from pemirl_trl.methods.loop import Metrics
from pemirl_trl.methods.policy_optimization import PolicyOptimization
from pemirl_trl.methods.stages import RunStage
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.action_cost import squared_action
from pemirl_trl.modules.family import FAR
from pemirl_trl.modules.model import Policy
from pemirl_trl.modules.reading import acted_steps
from pemirl_trl.transforms import InferContext

JUDGED_EPISODES = 100
"""Episodes in which policies are compared, about; at least 4 of each demonstration."""
JUDGED_SEED = 100_003
"""Added to the seed: policies are compared in episodes that none was trained on."""
FAR_SHARE = 0.05
"""Share of the steps on which r is asked far from its training that is worth a warning."""


HARD = 1.5
"""Times the demonstrator's squared actions from which a policy's are worth a word (docs/proofs.md:
the two tasks on which a cost of actions was missing had 1.9 and 4.5)."""


class PolicyTraining:
    """Trains policies on the learned rewards of demonstrations, and compares them.

    Args:
        model: whose rewards they are; on the CPU before and after each training.
        demonstrations: one of each new task, as the model reads them.
        episodes: make the environment.
        run_stage: runs a training.
        config: of the adaptation, with what actions cost.
        seed: of everything random.
        device: of the learner.

    Attributes:
        env_steps: of all trainings.
        history: metrics of each stage's iterations.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        demonstrations: DemonstrationDataset,
        episodes: Episodes,
        run_stage: RunStage,
        config: AdaptationConfig,
        seed: int,
        device: str = "cpu",
    ) -> None:
        self.model, self.demonstrations, self.seed = model, demonstrations, seed
        self._config, self._device = config, device
        self.env_steps = 0
        self.history: dict[str, list[Metrics]] = {}
        self._run_stage = run_stage
        self._episodes = episodes

    def __call__(self, stage: str, config: AdaptationConfig) -> tuple[Policy, str]:
        """Train one policy; also return the activation of its hidden layers."""
        count = len(self.demonstrations)
        rollouts = max(1, config.rollouts // count)
        torch.manual_seed(self.seed)
        policy, activation = initial_policy(self.model.to(self._device), config)
        policy.to(self._device)
        env = self._episodes(count * rollouts, self.seed, self._infer(rollouts))
        trajectories = self.demonstrations.trajectories()
        optimization = PolicyOptimization(
            env,
            policy,
            self.model.horizon,
            config.optimization,
            rollouts_per_context=rollouts,
            reward=objective(self.model, config, env),
            diagnostics=Diagnostics(self.model, trajectories, rollouts, reward_is_learned=False),
        )
        method = _Recorded(optimization)
        self._run_stage(stage, method)
        env.close(raise_if_closed=False)  # a collector may have closed it
        self.model.cpu()
        policy.cpu()
        self.env_steps += method.env_steps
        self.history[stage] = method.history
        return policy, activation

    def learned_return(self, policy: Policy) -> float:
        """What a policy's mean action earns, in the episodes that are common to all."""
        return float(self._rollouts(policy)["learned_reward"].sum(1).mean())

    @torch.no_grad()
    def _rollouts(self, policy: Policy) -> TensorDictBase:
        count = len(self.demonstrations)
        each = max(4, JUDGED_EPISODES // count)
        seed = self.seed + JUDGED_SEED
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            env = self._episodes(count * each, seed, self._infer(each))
            rollouts = whole_episodes(env, policy, self.model.horizon)
            objective(self.model, self._config, env)(rollouts)
            self._action_space = env.action_spec.space
            env.close(raise_if_closed=False)  # a collector may have closed it
        return rollouts

    def _infer(self, rollouts: int) -> InferContext:
        return InferContext(
            self.model.encoder,
            self.demonstrations.trajectories(),
            rollouts_per_context=rollouts,
            draw="all",
            sample=False,
        )

    def far_demonstrations(self) -> list[str]:
        """A warning for each demonstration that is far from those of training."""
        if self.model.family is None:
            return [
                "the model does not say what it was trained on: whether these demonstrations are "
                "of its family is unknown"
            ]
        distances = [infer(self.model, one).distance for one in self._each()]
        return [
            f"demonstration {i} is {distance}: its reward may mean nothing"
            for i, distance in enumerate(distances)
            if distance is not None and distance.far
        ]

    def _each(self) -> list[DemonstrationDataset]:
        return [self.demonstrations[i] for i in range(len(self.demonstrations))]

    def doubts(self, policy: Policy) -> list[str]:
        """Warnings of what a policy does in the episodes that are common to all."""
        rollouts = self._rollouts(policy)
        return [*self._far_states(rollouts), *self.hard_actions(rollouts)]

    def _far_states(self, rollouts: TensorDictBase) -> list[str]:
        """A warning where a policy takes r far from anything it was trained on."""
        family, features = self.model.family, self.model.config.reward_features
        if family is None:
            return []
        excess = family.excess(rollouts["observation"])
        read = [*range(excess.shape[-1])] if features is None else list(features)
        excess = excess[..., read].flatten(0, -2)
        share = float((excess.amax(-1) > FAR).float().mean())
        if share <= FAR_SHARE:
            return []
        worst = excess.amax(0)
        return [
            f"on {100 * share:.0f} % of its steps the policy takes r to states more than {FAR:g} "
            f"training deviations outside of what was demonstrated (up to "
            f"{float(worst.max()):.0f}, component {read[int(worst.argmax())]} of the "
            "observation): r was not trained there"
        ]

    def hard_actions(self, rollouts: TensorDictBase) -> list[str]:
        """A word where a policy acts much harder than the demonstrator did; of choices, none."""
        demonstrated, space = self.demonstrations, self._action_space
        if demonstrated.action_dim == 0 or not isinstance(space, ContinuousBox):
            return []
        bounds = (space.low[0], space.high[0])
        sizes = []
        for steps in (rollouts, demonstrated.trajectories()):
            squares, acted = squared_action(steps["action"], bounds), acted_steps(steps)
            sizes.append((squares if acted is None else squares[acted]).mean())
        spent, shown = sizes
        ratio = float(spent / shown.clamp(min=1e-12))
        if ratio <= HARD:
            return []
        return [
            f"the policy acts {ratio:.1f} times as hard as the demonstrators did (squares of "
            "actions): r is of states, and what acting costs is not in it. Where it has a price, "
            "give action_cost, and raise it until they act alike"
        ]


class _Recorded:
    """A method that remembers its metrics."""

    def __init__(self, method: PolicyOptimization) -> None:
        self._method, self.iterations = method, method.iterations
        self.history: list[Metrics] = []

    @property
    def env_steps(self) -> int:
        return self._method.env_steps

    def iteration(self) -> Metrics:
        metrics = self._method.iteration()
        self.history.append(metrics)
        return metrics

    def components(self) -> dict[str, Any]:
        return self._method.components()
