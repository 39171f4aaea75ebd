"""True returns over unseen tasks, beside those of the expert and of random actions."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.measuring.rollouts import evaluation_episodes, of_demonstrations, of_tasks
from pemirl_lab.results import Score
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.settings import Settings, variant
from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.evaluation import Actor, linear_probe, returns_per_task
from pemirl_trl.modules.model import Policy


def load_test_demonstrations(settings: Settings) -> DemonstrationDataset:
    """The first demonstration of each unseen task."""
    every = DemonstrationDataset.load(data_file(settings.test_demonstrations))
    return every[:: settings.demonstrations_per_task]


@torch.no_grad()
def context_measures(settings: Settings, model: PEMIRLModel) -> dict[str, float]:
    """How well the task can be read off the contexts of held-out demonstrations, all there are.

    A linear probe is fitted on the training demonstrations; empty for a model without contexts.
    """
    if model.config.context_dim == 0:
        return {}
    halves = []
    for name in (settings.demonstrations, settings.test_demonstrations):
        demonstrations = DemonstrationDataset.load(data_file(name))
        task = demonstrations.tasks()[settings.task_key]
        halves += [model.encoder.get_dist(demonstrations.trajectories()).mean, task]
    return {f"context/{name}": value for name, value in linear_probe(*halves).items()}


class Scorer:
    """Scores policies on the mean action, m the mean of q(m | demonstration).

    Args:
        settings: of the run.
        demonstrations: one of each unseen task.
    """

    def __init__(self, settings: Settings, demonstrations: DemonstrationDataset) -> None:
        self.settings, self.demonstrations = settings, demonstrations
        self._references: dict[str, dict[str, Tensor]] = {}

    def references(self, environment: str) -> dict[str, Tensor]:
        """Returns ``[tasks]`` of ``expert`` and ``random`` under some dynamics; measured once."""
        if environment not in self._references:
            expert = load_expert(self.settings.expert_file(environment))
            actors: dict[str, Actor] = {"expert": expert, "random": None}
            self._references[environment] = {
                name: self._of_tasks(environment, actor) for name, actor in actors.items()
            }
        return self._references[environment]

    def _of_tasks(self, environment: str, actor: Actor) -> Tensor:
        tasks, episodes = self.demonstrations.tasks(), self.settings.evaluation.episodes
        transform = of_tasks(tasks, episodes)
        rollouts = evaluation_episodes(self.settings, environment, actor, transform, len(tasks))
        return returns_per_task(rollouts, episodes)

    def returns(self, environment: str, model: PEMIRLModel, policy: Policy) -> Tensor:
        """True returns ``[tasks]`` of a policy that reads the contexts of the demonstrations."""
        episodes, count = self.settings.evaluation.episodes, len(self.demonstrations)
        transform = of_demonstrations(model, self.demonstrations, episodes)
        rollouts = evaluation_episodes(self.settings, environment, policy, transform, count)
        return returns_per_task(rollouts, episodes)

    def scores(
        self,
        setting: str,
        environment: str,
        model: PEMIRLModel,
        policy: Policy,
        env_steps: Mapping[str, int],
    ) -> list[Score]:
        """Scores of a policy under some dynamics, one for each set of goals."""
        references = self.references(environment)
        returns = self.returns(environment, model, policy)
        return [
            Score(
                variant=variant(environment),
                setting=setting,
                goals=goals,
                per_task=tuple(returns[chosen].tolist()),
                random=float(references["random"][chosen].mean()),
                expert=float(references["expert"][chosen].mean()),
                env_steps=dict(env_steps),
            )
            for goals, chosen in self._subsets().items()
        ]

    def _subsets(self) -> dict[str, Tensor]:
        tasks = self.demonstrations.tasks()
        every = {"all": torch.ones(len(tasks), dtype=torch.bool)}
        return every | {name: some.mask(tasks) for name, some in self.settings.subsets.items()}
