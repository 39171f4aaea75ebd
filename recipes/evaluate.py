"""Evaluate a meta-trained model: a table, results files, reward maps and learning curves.

    python recipes/evaluate.py                       # of the runs of meta_train.py, adapt_reward.py
    python recipes/evaluate.py results=results/point_maze meta_run=... adaptation_run=...

One-shot returns on the training dynamics; policy generalisation and reward adaptation on the
changed ones. Each of the last policy, of the mean action, with m the mean of q(m | demonstration).
"""

from __future__ import annotations

import json
from pathlib import Path

import hydra
import torch
from adapt_reward import load_test_demonstrations
from config import plain
from domains import (
    load_expert,
    returns_given_demonstrations,
    returns_given_tasks,
    returns_of_random_actions,
)
from drawing import draw_learning_curve, draw_reward_maps
from omegaconf import DictConfig
from run_folder import RunFolder, say
from torch import Tensor

from pemirl_trl import ContextPolicy, DemonstrationDataset, PEMIRLModel
from pemirl_trl.checkpoint import load_weights, read_metadata
from pemirl_trl.evaluation import Result, table
from pemirl_trl.pretrained import load_model

GOAL_SETS = {"all": (-float("inf"), float("inf")), "x_in_0.1_0.4": (0.1, 0.4)}
"""Which test goals, by the range of their x in metres; the second is the authors' test."""


def evaluate(
    config: DictConfig,
    folder: RunFolder,
    meta_run: Path,
    adaptation_run: Path,
) -> list[Result]:
    """Measure, write results and figures, print the table."""
    torch.manual_seed(config.seed)
    model = load_model(meta_run / "model.safetensors")
    meta_il = load_model(meta_run / "meta_il.safetensors")
    demonstrations = load_test_demonstrations(config)
    adapted = model.new_policy(config.adaptation.policy_scale)
    facts = load_weights(adaptation_run / "policy.safetensors", {"policy": adapted})
    steps = {
        "meta_training": int(read_metadata(meta_run / "model.safetensors")["env_steps"]),
        "adaptation": int(facts["env_steps"]),
    }
    with folder.timed("evaluation"):
        returns = _measure(config, model, meta_il, adapted, demonstrations)
    seconds = _seconds(meta_run) | _seconds(adaptation_run) | folder.seconds
    results = _results(config, returns, demonstrations, steps, seconds)
    directory = Path(config.results)
    for result in results:
        name = (result.method, result.setting, result.variant, result.goals, f"seed{result.seed}")
        result.write(directory / ("-".join(name) + ".json"))
    say(table(results))
    draw_reward_maps(config, model, demonstrations, folder.file("figures/reward_maps.png"))
    draw_learning_curve(
        config, (meta_run, adaptation_run), results, folder.file("figures/learning_curve.png")
    )
    say(f"results -> {directory}, figures -> {folder.file('figures')}")
    return results


def _measure(
    config: DictConfig,
    model: PEMIRLModel,
    meta_il: PEMIRLModel,
    adapted: ContextPolicy,
    demonstrations: DemonstrationDataset,
) -> dict[tuple[str, str, str], Tensor]:
    """True returns ``[tasks]`` by (environment, method, setting); baselines have no setting."""
    train, test = config.environment, config.test_environment
    returns: dict[tuple[str, str, str], Tensor] = {}
    for env in dict.fromkeys((train, test)):
        expert = load_expert(config.experts[env.split("/")[1]])
        returns[env, "expert", ""] = returns_given_tasks(
            env, expert, demonstrations.tasks(), config
        )
        returns[env, "random", ""] = returns_of_random_actions(env, demonstrations.tasks(), config)
    for name, networks in (("meta_il", meta_il), (config.method, model)):
        for env, setting in ((train, "one_shot"), (test, "policy_generalisation")):
            returns[env, name, setting] = returns_given_demonstrations(
                env, networks, networks.policy, demonstrations, config
            )
    returns[test, config.method, "reward_adaptation"] = returns_given_demonstrations(
        test, model, adapted, demonstrations, config
    )
    return returns


def _results(
    config: DictConfig,
    returns: dict[tuple[str, str, str], Tensor],
    demonstrations: DemonstrationDataset,
    steps: dict[str, int],
    seconds: dict[str, float],
) -> list[Result]:
    x = demonstrations.tasks()["goal"][:, 0]
    results = []
    for (env, method, setting), per_task in returns.items():
        if not setting:
            continue
        task, variant = env.split("/")
        for goals, (low, high) in GOAL_SETS.items():
            chosen = (x >= low) & (x <= high)
            used = {
                "meta_training": 0 if method == "meta_il" else steps["meta_training"],
                "adaptation": steps["adaptation"] if setting == "reward_adaptation" else 0,
            }
            results.append(
                Result.measured(
                    task=task,
                    variant=variant,
                    method=method,
                    setting=setting,
                    seed=config.seed,
                    goals=goals,
                    per_task=per_task[chosen].tolist(),
                    random=float(returns[env, "random", ""][chosen].mean()),
                    expert=float(returns[env, "expert", ""][chosen].mean()),
                    env_steps=used,
                    seconds=seconds,
                    config=plain(config),
                )
            )
    return results


def _seconds(run: Path) -> dict[str, float]:
    file = run / "seconds.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}


@hydra.main(config_path="conf", config_name="evaluate", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    evaluate(config, RunFolder(config), Path(config.meta_run), Path(config.adaptation_run))


if __name__ == "__main__":
    main()
