"""True returns over unseen tasks, beside those of the expert and of random actions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from config import typed
from domains import (
    data_file,
    load_expert,
    returns_given_demonstrations,
    returns_given_tasks,
    returns_of_random_actions,
)
from omegaconf import DictConfig
from tensordict import TensorDictBase

from pemirl_trl import ContextPolicy, DemonstrationDataset, PEMIRLModel
from pemirl_trl.evaluation import Score, linear_probe


@dataclass(frozen=True)
class Subset:
    """Which unseen tasks, by the closed range of one component of one of their parameters."""

    parameter: str
    index: int
    low: float
    high: float

    def mask(self, tasks: TensorDictBase) -> torch.Tensor:
        """Which of ``tasks`` ``[C]`` belong to it, bool ``[C]``."""
        value = tasks[self.parameter][:, self.index]
        return (value >= self.low) & (value <= self.high)


@torch.no_grad()
def context_measures(config: DictConfig, model: PEMIRLModel) -> dict[str, float]:
    """How well the task can be read off the contexts of held-out demonstrations, all there are.

    A linear probe is fitted on the training demonstrations; empty for a model without contexts.
    """
    if model.config.context_dim == 0:
        return {}
    halves = []
    for name in (config.demonstrations, config.test_demonstrations):
        demonstrations = DemonstrationDataset.load(data_file(name))
        task = demonstrations.tasks()[config.task_key]
        halves += [model.encoder.get_dist(demonstrations.trajectories()).mean, task]
    return {f"context/{name}": value for name, value in linear_probe(*halves).items()}


class Scorer:
    """Scores policies on the mean action, m the mean of q(m | demonstration).

    Args:
        config: of the run; has ``experts`` by variant, ``subsets`` and ``evaluation``.
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
        return [
            Score(
                variant=environment.split("/")[1],
                setting=setting,
                goals=goals,
                per_task=tuple(returns[chosen].tolist()),
                random=float(references["random"][chosen].mean()),
                expert=float(references["expert"][chosen].mean()),
                env_steps=dict(env_steps),
            )
            for goals, chosen in self._subsets().items()
        ]

    def _subsets(self) -> dict[str, torch.Tensor]:
        tasks = self.demonstrations.tasks()
        masks = {"all": torch.ones(len(tasks), dtype=torch.bool)}
        for name, range_ in self.config.subsets.items():
            masks[str(name)] = typed(Subset, range_).mask(tasks)
        return masks
