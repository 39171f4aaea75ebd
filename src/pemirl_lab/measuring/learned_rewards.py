"""How close a reward is to the true one, on a domain of this package."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

import pemirl_envs
from pemirl_lab.measuring.candidates import Candidate
from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.measuring.rollouts import evaluation_episodes, of_tasks, true_reward_module
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset
from pemirl_trl.configuration import CHECKED, Count
from pemirl_trl.evaluation import (
    Actor,
    RewardFunction,
    RewardReport,
    position_grid,
    reward_report,
)
from pemirl_trl.evaluation.reward_quality import Bounds


@dataclass(frozen=True, config=CHECKED)
class ReportConfig:
    """What is measured.

    Attributes:
        episodes: per task, of random actions and of the expert.
        resolution: cells of a map along each axis.
        epic_transitions, epic_samples, features: see
            :func:`pemirl_trl.evaluation.reward_report`.
    """

    episodes: Count = 5
    resolution: Count = 60
    epic_transitions: Count = 128
    epic_samples: Count = 64
    features: Count = 64


def measure_reward(
    settings: Settings,
    report: ReportConfig,
    candidate: Candidate,
    demonstrations: DemonstrationDataset,
    coverage: Mapping[str, TensorDictBase] | None = None,
) -> RewardReport:
    """Measure a candidate's rewards under the test dynamics.

    On a planar task the true reward is a function of a position, so that EPIC and maps are there.

    Args:
        settings: of the run.
        report: what is measured.
        candidate: what is measured.
        demonstrations: one per task, with the tasks.
        coverage: of :func:`coverage_of`, where it is there already.
    """
    if coverage is None:
        coverage = coverage_of(settings, report.episodes, candidate.context, demonstrations)
    planar = settings.planar
    return reward_report(
        candidate.rewards,
        true_reward(settings.test_environment) if planar else None,
        coverage,
        gamma=candidate.gamma,
        positions=grid(settings, report.resolution)[1] if planar else None,
        goals=demonstrations.tasks()["goal"] if planar else None,
        epic_transitions=report.epic_transitions,
        epic_samples=report.epic_samples,
        features=report.features,
        seed=settings.evaluation.seed,
    )


def coverage_of(
    settings: Settings, episodes: int, context: Tensor, demonstrations: DemonstrationDataset
) -> dict[str, TensorDictBase]:
    """Transitions ``[C, episodes * T]`` under the test dynamics, with ``context`` and ``task``.

    Of uniformly random actions; of the expert's mean actions; and every second one of both. Of
    each task, ``context`` ``[C, D]`` goes with it.
    """
    tasks = demonstrations.tasks()
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.evaluation.seed)
        actor = load_expert(settings.expert_file(settings.test_environment))
        random = _transitions(settings, episodes, None, tasks, context)
        expert = _transitions(settings, episodes, actor, tasks, context)
    mixed = torch.cat([random[:, ::2], expert[:, ::2]], dim=1)
    return {"random": random, "expert": expert, "mixed": mixed}


def _transitions(
    settings: Settings, episodes: int, actor: Actor, tasks: TensorDictBase, context: Tensor
) -> TensorDict:
    rollouts = evaluation_episodes(
        settings,
        settings.test_environment,
        actor,
        of_tasks(tasks, episodes),
        len(tasks),
        episodes=episodes,
    )  # [C * episodes, T]
    kept = rollouts.select("observation", "action", ("next", "observation"), ("next", "reward"))
    kept["task"] = rollouts["task"]
    kept = kept.reshape(len(tasks), episodes * rollouts.shape[1]).contiguous()
    return kept.set("context", context.unsqueeze(1).expand(*kept.shape, -1))


def true_reward(name: str) -> RewardFunction:
    """The reward that a planar task gives for any transition, possible or not."""
    module = true_reward_module(name)

    def reward(transitions: TensorDictBase) -> Tensor:
        return module(transitions.select(*module.in_keys))["learned_reward"].squeeze(-1)

    return reward


def grid(settings: Settings, cells: int) -> tuple[Bounds, Tensor]:
    """The box of the test dynamics' plan, and a grid of positions ``[cells, cells, 2]`` in it."""
    plan = pemirl_envs.layout(settings.test_environment)
    bounds = ((plan.low[0], plan.high[0]), (plan.low[1], plan.high[1]))
    return bounds, position_grid(bounds, (cells, cells))
