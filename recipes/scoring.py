"""True returns over unseen tasks, beside those of the expert and of random actions."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from domains import (
    load_expert,
    returns_given_demonstrations,
    returns_given_tasks,
    returns_of_random_actions,
)
from omegaconf import DictConfig

from pemirl_trl import ContextPolicy, DemonstrationDataset, PEMIRLModel
from pemirl_trl.evaluation import Score

GOAL_SETS = {"all": (-float("inf"), float("inf")), "x_in_0.1_0.4": (0.1, 0.4)}
"""Which goals, by the range of their x in metres; the second is the test of the authors' code."""


class Scorer:
    """Scores policies on the mean action, m the mean of q(m | demonstration).

    Args:
        config: of the run; has ``experts`` by variant and ``evaluation``.
        demonstrations: one of each unseen task.
    """

    def __init__(self, config: DictConfig, demonstrations: DemonstrationDataset) -> None:
        self.config, self.demonstrations = config, demonstrations
        self._references: dict[str, dict[str, torch.Tensor]] = {}

    def references(self, environment: str) -> dict[str, torch.Tensor]:
        """Returns ``[tasks]`` of ``expert`` and ``random`` under some dynamics; measured once."""
        if environment not in self._references:
            expert = load_expert(self.config.experts[environment.split("/")[1]])
            tasks = self.demonstrations.tasks()
            self._references[environment] = {
                "expert": returns_given_tasks(environment, expert, tasks, self.config),
                "random": returns_of_random_actions(environment, tasks, self.config),
            }
        return self._references[environment]

    def scores(
        self,
        setting: str,
        environment: str,
        model: PEMIRLModel,
        policy: ContextPolicy,
        env_steps: Mapping[str, int],
    ) -> list[Score]:
        """Scores of a policy under some dynamics, one for each set of goals."""
        references = self.references(environment)
        returns = returns_given_demonstrations(
            environment, model, policy, self.demonstrations, self.config
        )
        x = self.demonstrations.tasks()["goal"][:, 0]
        scores = []
        for goals, (low, high) in GOAL_SETS.items():
            chosen = (x >= low) & (x <= high)
            scores.append(
                Score(
                    variant=environment.split("/")[1],
                    setting=setting,
                    goals=goals,
                    per_task=tuple(returns[chosen].tolist()),
                    random=float(references["random"][chosen].mean()),
                    expert=float(references["expert"][chosen].mean()),
                    env_steps=dict(env_steps),
                )
            )
        return scores
