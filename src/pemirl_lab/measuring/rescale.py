"""Stored results, normalised by another expert. What was returned stays as it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from tensordict import TensorDictBase

import pemirl_envs
from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.measuring.rollouts import evaluation_episodes, of_tasks
from pemirl_lab.results import Result, Score, read
from pemirl_lab.runs.settings import Settings
from pemirl_trl.evaluation import returns_per_task


class Yardstick:
    """Mean returns of a task's present experts, by dynamics, split and set of goals.

    Args:
        settings: say which experts there are, and how policies are evaluated.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._returns: dict[tuple[str, str], torch.Tensor] = {}

    def expert(self, variant: str, split: str, goals: str) -> float:
        """The mean return of the expert of some dynamics over a split's tasks, or some of them."""
        name = f"{self.settings.task}/{variant}"
        tasks = pemirl_envs.task_parameters(name, split)
        if (name, split) not in self._returns:
            self._returns[name, split] = self._measure(name, tasks)
        returns = self._returns[name, split]
        chosen = returns if goals == "all" else returns[self.settings.subsets[goals].mask(tasks)]
        return float(chosen.mean())

    def _measure(self, name: str, tasks: TensorDictBase) -> torch.Tensor:
        episodes = self.settings.evaluation.episodes
        torch.manual_seed(self.settings.evaluation.seed)
        policy = load_expert(self.settings.expert_file(name))
        transform = of_tasks(tasks, episodes)
        rollouts = evaluation_episodes(self.settings, name, policy, transform, len(tasks))
        return returns_per_task(rollouts, episodes)


def rescaled(result: Result, variants: Sequence[str], yardstick: Yardstick) -> Result:
    """A result whose scores under some dynamics are normalised by the present expert there."""
    return replace(
        result,
        scores=tuple(
            _rescaled(score, yardstick.expert(score.variant, result.split, score.goals))
            if score.variant in variants
            else score
            for score in result.scores
        ),
    )


def _rescaled(score: Score, expert: float) -> Score:
    return replace(score, expert=expert, normalised=float("nan"))  # filled in anew


def rescale(
    settings: Settings, tables: Sequence[Path], variants: Sequence[str]
) -> Mapping[str, int]:
    """Normalise everything below some folders by the present experts of some dynamics.

    Returns:
        How many files changed, by folder.
    """
    yardstick, changed = Yardstick(settings), dict.fromkeys(map(str, tables), 0)
    for folder in tables:
        for file in sorted(folder.glob("*/seed*.json")):
            before = read(file)
            after = rescaled(before, variants, yardstick)
            if after != before:
                after.write(file)
                changed[str(folder)] += 1
    return changed
