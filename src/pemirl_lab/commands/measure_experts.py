"""What a task's experts reach, and the training expert where the dynamics have changed.

    python recipes/measure_experts.py task=ant

Two rows of the task's table, ``results/TASK/expert`` and ``results/TASK/expert_carried_over``: true
returns of the mean action over the test tasks, and what a person would look at (``outcomes.py``).
Two more, ``scripted`` and ``scripted_carried_over``, where the task has controllers by hand
(``yardsticks.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import hydra
import torch
from config import plain
from domains import Actor, data_file, load_expert, rollouts_given_tasks
from omegaconf import DictConfig
from outcomes import OUTCOMES
from run_folder import say
from torch import Tensor
from yardsticks import YARDSTICKS

import pemirl_envs
from pemirl_trl.evaluation import Result, Score, environment_facts, returns_table
from pemirl_trl.files import read_metadata

Measured = tuple[Tensor, float]
"""Returns ``[tasks]``, and the outcome's mean over the tasks."""


def measure(name: str, policy: Actor, config: DictConfig) -> Measured:
    """A policy that reads the task (or random actions) under some dynamics, on the test tasks."""
    tasks, episodes = pemirl_envs.task_parameters(name, "test"), config.evaluation.episodes
    torch.manual_seed(config.evaluation.seed)
    rollouts = rollouts_given_tasks(name, policy, tasks, config)
    returns = rollouts["next", "reward"].sum((1, 2)).view(len(tasks), episodes).mean(1)
    _, outcome = OUTCOMES[config.task]
    reached = outcome(rollouts["next", "observation"], rollouts["task"][:, 0])
    return returns, float(reached.mean())


class Measurement(NamedTuple):
    """A policy, where it acts, and the environment steps that it was trained on."""

    setting: str
    environment: str
    policy: Actor
    env_steps: int


def measure_experts(config: DictConfig) -> list[Result]:
    """Every expert on the dynamics that it was trained on, and the first one on the test's."""
    torch.set_num_threads(1)
    training, test = config.environment, config.test_environment
    own = [_expert(config, name) for name in (training, test)]
    lost = own[0]._replace(setting="policy_generalisation", environment=test)
    rows = {"expert": own, "expert_carried_over": [lost]}
    if training in YARDSTICKS:
        scripted = [m._replace(policy=YARDSTICKS[m.environment], env_steps=0) for m in own]
        rows["scripted"] = scripted
        rows["scripted_carried_over"] = [lost._replace(policy=scripted[0].policy, env_steps=0)]
    measured = {
        row: [measure(m.environment, m.policy, config) for m in chosen]
        for row, chosen in rows.items()
    }
    scales = {
        m.environment: (float(measure(m.environment, None, config)[0].mean()), float(expert.mean()))
        for m, (expert, _) in zip(own, measured["expert"], strict=True)
    }
    results = [_result(config, row, rows[row], measured[row], scales) for row in rows]
    for result in results:
        result.write(Path(config.results) / result.row / "seed0.json")
    say(returns_table(results))
    for result in results:
        for outcome, value in result.reward.items():
            say(f"{result.row}: {outcome} {value:.3f}")
    return results


def _expert(config: DictConfig, environment: str) -> Measurement:
    path = config.experts[_variant(environment)]
    steps = int(read_metadata(data_file(path))["env_steps"])
    return Measurement("expert", environment, load_expert(path), steps)


def _variant(environment: str) -> str:
    return environment.split("/")[1]


def _result(
    config: DictConfig,
    row: str,
    measurements: Sequence[Measurement],
    measured: Sequence[Measured],
    scales: Mapping[str, tuple[float, float]],
) -> Result:
    """``scales``: mean returns of random actions and of the expert, by environment."""
    scores, outcomes = [], {}
    for m, (returns, outcome) in zip(measurements, measured, strict=True):
        random, expert = scales[m.environment]
        score = Score(
            variant=_variant(m.environment),
            setting=m.setting,
            goals="all",
            per_task=tuple(returns.tolist()),
            random=random,
            expert=expert,
            env_steps={"meta_training": m.env_steps, "adaptation": 0},
        )
        scores.append(score)
        outcomes[f"{OUTCOMES[config.task][0]}/{score.variant}"] = outcome
    return Result(
        table=config.table_name,
        row=row,
        task=config.task,
        seed=0,
        split="test",
        scores=tuple(scores),
        reward=outcomes,
        seconds={},
        config=plain(config),
        **environment_facts(),
    )


@hydra.main(config_path="conf", config_name="measure_experts", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    measure_experts(config)


if __name__ == "__main__":
    main()
