"""What a task's experts reach, and the training expert where the dynamics have changed.

    pemirl measure_experts task=ant
    pemirl measure_experts task=ant rescale=[disabled]      # that expert is a new one

Two rows of the task's table, ``results/TASK/expert`` and ``results/TASK/expert_carried_over``: true
returns of the mean action over the test tasks, and what a person would look at (the task's
``outcomes``). Two more, ``scripted`` and ``scripted_carried_over``, where the task has controllers
by hand. Where an expert has been replaced, ``rescale`` names its dynamics: what is stored in the
task's tables is then normalised by the new one. The returns stay as they were.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torch import Tensor

import pemirl_envs
from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.measuring.rescale import rescale
from pemirl_lab.measuring.rollouts import evaluation_episodes, of_tasks
from pemirl_lab.pages.tables import returns_table
from pemirl_lab.results import Result, Score, environment_facts
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.run_folder import say
from pemirl_lab.runs.settings import Settings, variant
from pemirl_trl.configuration import CHECKED
from pemirl_trl.evaluation import Actor, returns_per_task
from pemirl_trl.files import read_metadata


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own: where results go, and the table they belong to.

    ``rescale``: dynamics whose expert is a new one; stored results are normalised by it.
    """

    results: str
    table_name: str
    rescale: list[str]


class Measurement(NamedTuple):
    """A policy, where it acts, and the environment steps that it was trained on."""

    setting: str
    environment: str
    policy: Actor
    env_steps: int


Measured = tuple[Tensor, dict[str, float]]
"""Returns ``[tasks]``, and the outcomes' means over the tasks."""


def run(settings: Settings, own: Own) -> list[Result]:
    """Every expert on the dynamics that it was trained on, and the first one on the test's."""
    training, test = settings.environment, settings.test_environment
    experts = [_expert(settings, name) for name in (training, test)]
    lost = experts[0]._replace(setting="policy_generalisation", environment=test)
    rows = {"expert": experts, "expert_carried_over": [lost]}
    scripted = [_scripted(name) for name in (training, test)]
    if all(actor is not None for actor in scripted):
        by_hand = [
            m._replace(policy=actor, env_steps=0)
            for m, actor in zip(experts, scripted, strict=True)
        ]
        rows["scripted"] = by_hand
        rows["scripted_carried_over"] = [lost._replace(policy=by_hand[0].policy, env_steps=0)]
    measured = {
        row: [measure(settings, m.environment, m.policy) for m in chosen]
        for row, chosen in rows.items()
    }
    scales = {
        m.environment: (_mean(measure(settings, m.environment, None)), float(expert.mean()))
        for m, (expert, _) in zip(experts, measured["expert"], strict=True)
    }
    results = [_result(settings, own, row, rows[row], measured[row], scales) for row in rows]
    for result in results:
        result.write(Path(own.results) / result.row / "seed0.json")
    tables = [Path(own.results), Path(f"{own.results}_confirm")]
    for folder, count in rescale(settings, tables, own.rescale).items():
        say(f"{folder}: {count} results normalised by the present experts")
    say(returns_table(results))
    for result in results:
        for outcome, value in result.reward.items():
            say(f"{result.row}: {outcome} {value:.3f}")
    return results


def measure(settings: Settings, name: str, policy: Actor) -> Measured:
    """A policy that reads the task (or random actions) under some dynamics, on the test tasks."""
    tasks, episodes = pemirl_envs.task_parameters(name, "test"), settings.evaluation.episodes
    torch.manual_seed(settings.evaluation.seed)
    rollouts = evaluation_episodes(settings, name, policy, of_tasks(tasks, episodes), len(tasks))
    of_rollouts = rollouts["task"][:, 0]
    reached = {
        outcome: float(function(rollouts["next", "observation"], of_rollouts).mean())
        for outcome, function in pemirl_envs.get_task(name).outcomes.items()
    }
    return returns_per_task(rollouts, episodes), reached


def _mean(measured: Measured) -> float:
    return float(measured[0].mean())


def _expert(settings: Settings, environment: str) -> Measurement:
    path = settings.expert_file(environment)
    steps = int(read_metadata(data_file(path))["env_steps"])
    return Measurement("expert", environment, load_expert(path), steps)


def _scripted(name: str) -> Actor:
    """The task's controller by hand; None where it has none."""
    controller = pemirl_envs.get_task(name).scripted_controller()
    if controller is None:
        return None

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", controller(tensordict["observation"], tensordict["task"]))

    return act


def _result(
    settings: Settings,
    own: Own,
    row: str,
    measurements: Sequence[Measurement],
    measured: Sequence[Measured],
    scales: Mapping[str, tuple[float, float]],
) -> Result:
    """``scales``: mean returns of random actions and of the expert, by environment."""
    scores: list[Score] = []
    reached: dict[str, float] = {}
    for m, (returns, outcomes) in zip(measurements, measured, strict=True):
        random, expert = scales[m.environment]
        score = Score(
            variant=variant(m.environment),
            setting=m.setting,
            goals="all",
            per_task=tuple(returns.tolist()),
            random=random,
            expert=expert,
            env_steps={"meta_training": m.env_steps, "adaptation": 0},
        )
        scores.append(score)
        reached |= {f"{name}/{score.variant}": value for name, value in outcomes.items()}
    return Result(
        table=own.table_name,
        row=row,
        task=settings.task,
        seed=0,
        split="test",
        scores=tuple(scores),
        reward=reached,
        seconds={},
        config=dict(settings.resolved),
        **environment_facts(),
    )
