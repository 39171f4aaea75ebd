"""What a task's experts reach, and the training expert where the dynamics have changed.

    python recipes/measure_experts.py task=ant

Two rows of the task's table, ``results/TASK/expert`` and ``results/TASK/expert_carried_over``: true
returns of the mean action over the test tasks, and what a person would look at (``outcomes.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import hydra
import torch
from config import plain
from domains import data_file, load_expert, rollouts_given_tasks
from omegaconf import DictConfig
from outcomes import OUTCOMES
from run_folder import say

import pemirl_envs
from pemirl_trl import ContextPolicy
from pemirl_trl.evaluation import Result, Score, environment_facts, returns_table
from pemirl_trl.files import read_metadata

Measured = tuple[torch.Tensor, float]
"""Returns ``[tasks]``, and the outcome's mean over the tasks."""


def measure(name: str, policy: ContextPolicy | None, config: DictConfig) -> Measured:
    """A policy that reads the task (or random actions) under some dynamics, on the test tasks."""
    tasks, episodes = pemirl_envs.task_parameters(name, "test"), config.evaluation.episodes
    torch.manual_seed(config.evaluation.seed)
    rollouts = rollouts_given_tasks(name, policy, tasks, config)
    returns = rollouts["next", "reward"].sum((1, 2)).view(len(tasks), episodes).mean(1)
    _, outcome = OUTCOMES[config.task]
    reached = outcome(rollouts["next", "observation"], rollouts["task"][:, 0])
    return returns, float(reached.mean())


def measure_experts(config: DictConfig) -> list[Result]:
    """Every expert on the dynamics that it was trained on, and the first one on the test's."""
    torch.set_num_threads(1)
    domain, unit = config.task, OUTCOMES[config.task][0]
    own, carried = [], []
    measures: dict[str, float] = {}
    training, test = (config[k].split("/")[1] for k in ("environment", "test_environment"))
    for variant in (training, test):
        name = f"{domain}/{variant}"
        random, _ = measure(name, None, config)
        expert, measures[f"{unit}/{variant}"] = measure(name, _expert(config, variant), config)
        own.append(_score(config, variant, "expert", (expert, random, expert), variant))
        if variant == test:
            lost, distance = measure(name, _expert(config, training), config)
            scores = (lost, random, expert)
            carried.append(_score(config, variant, "policy_generalisation", scores, training))
    rows = {
        "expert": (own, measures),
        "expert_carried_over": (carried, {f"{unit}/{test}": distance}),
    }
    results = [_result(config, row, *values) for row, values in rows.items()]
    for result in results:
        result.write(Path(config.results) / result.row / "seed0.json")
    say(returns_table(results))
    for result in results:
        for measured, value in result.reward.items():
            say(f"{result.row}: {measured} {value:.3f}")
    return results


def _expert(config: DictConfig, variant: str) -> ContextPolicy:
    return load_expert(config.experts[variant])


def _score(
    config: DictConfig, variant: str, setting: str, returns: Sequence[torch.Tensor], trained: str
) -> Score:
    policy, random, expert = returns
    steps = read_metadata(data_file(config.experts[trained]))["env_steps"]
    return Score(
        variant=variant,
        setting=setting,
        goals="all",
        per_task=tuple(policy.tolist()),
        random=float(random.mean()),
        expert=float(expert.mean()),
        env_steps={"meta_training": int(steps), "adaptation": 0},
    )


def _result(
    config: DictConfig, row: str, scores: Sequence[Score], measures: dict[str, float]
) -> Result:
    return Result(
        table=config.table_name,
        row=row,
        task=config.task,
        seed=0,
        split="test",
        scores=tuple(scores),
        reward=measures,
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
