"""Evaluate a meta-trained model: a table, a results file, reward maps and learning curves.

    python recipes/evaluate.py                       # of the runs of meta_train.py, adapt_reward.py
    python recipes/evaluate.py task=ant trained=pemirl   # of another method's
    python recipes/evaluate.py meta_run=... adaptation_run=...

One-shot returns on the training dynamics; policy generalisation and reward adaptation on the
changed ones. Each of the last policy, of the mean action, with m the mean of q(m | demonstration).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import hydra
import torch
from adapt_reward import load_adapted, load_test_demonstrations
from behaviours import behaviour_measures
from config import plain
from domains import run_file
from drawing import draw_learning_curve, draw_reward_maps
from omegaconf import DictConfig, OmegaConf
from run_folder import RunFolder, say
from scoring import Scorer, context_measures

from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.evaluation import Result, Score, environment_facts, returns_table
from pemirl_trl.files import read_metadata
from pemirl_trl.pretrained import load_model


def evaluate(
    config: DictConfig, folder: RunFolder, meta_run: Path, adaptation_run: Path
) -> list[Result]:
    """Measure, write results and figures, print the table."""
    torch.manual_seed(config.seed)
    trained = meta_run / "model.safetensors"
    model, method = load_model(trained), read_metadata(trained)["method"]
    demonstrations = load_test_demonstrations(config)
    runs = {method: meta_run, "adaptation": adaptation_run}
    rewards = {method: context_measures(config, model)}
    behaviours = {} if config.planar else behaviour_measures(config, model)
    with folder.timed("evaluation"):
        scores = {method: _scores(config, model, demonstrations, meta_run, adaptation_run)}
        if (meta_run / "meta_il.safetensors").exists():
            meta_il = load_model(meta_run / "meta_il.safetensors")
            scores["meta_il"] = _transfer(config, meta_il, demonstrations, 0)
            rewards["meta_il"] = context_measures(config, meta_il)
    for row, contexts in rewards.items():
        if contexts:
            read_off = ", ".join(f"{k.split('/')[1]} {v:.3f}" for k, v in contexts.items())
            say(f"{row}: the task, read off the contexts of held-out demonstrations: {read_off}")
    for name, value in behaviours.items():
        say(f"{method}, {name}: {value:.3f}")
    rewards[method] |= behaviours
    curves = {method: {stage: read_curve(run, stage) for stage, run in runs.items()}}
    results = _results(config, folder, runs, scores, rewards, curves)
    for result in results:
        result.write(Path(config.results) / f"{result.row}.json")
    say(returns_table(results))
    if config.planar:
        draw_reward_maps(config, model, demonstrations, folder.file("figures/reward_maps.png"))
    draw_learning_curve(config, runs, scores[method], folder.file("figures/learning_curve.png"))
    say(f"results -> {config.results}, figures -> {folder.file('figures')}")
    return results


def _results(
    config: DictConfig,
    folder: RunFolder,
    runs: Mapping[str, Path],
    scores: Mapping[str, Sequence[Score]],
    rewards: Mapping[str, dict[str, float]],
    curves: Mapping[str, dict[str, list[list[float]]]],
) -> list[Result]:
    """A result of each row of ``scores``; ``runs``: the run of each stage."""
    meta_run, adaptation_run = runs.values()
    settings = plain(config)
    if meta_run != folder.path:  # the quickstart is one run
        settings["runs"] = {
            "meta_training": read_run(meta_run),
            "adaptation": read_run(adaptation_run),
        }
    return [
        Result(
            table=config.table_name,
            row=row,
            task=config.task,
            seed=config.seed,
            split="test",
            scores=tuple(of_row),
            curves=curves.get(row, {}),
            reward=rewards.get(row, {}),
            seconds=read_seconds(meta_run) | read_seconds(adaptation_run) | folder.seconds,
            config=settings,
            **environment_facts(),
        )
        for row, of_row in scores.items()
    ]


def _transfer(
    config: DictConfig, model: PEMIRLModel, demonstrations: DemonstrationDataset, steps: int
) -> list[Score]:
    """The meta-trained policy, where it was trained and where the dynamics have changed."""
    scorer = Scorer(config, demonstrations)
    used = {"meta_training": steps, "adaptation": 0}
    where = (("one_shot", config.environment), ("policy_generalisation", config.test_environment))
    return [
        s for setting, env in where for s in scorer.scores(setting, env, model, model.policy, used)
    ]


def _scores(
    config: DictConfig,
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    meta_run: Path,
    adaptation_run: Path,
) -> list[Score]:
    adapted, adaptation = load_adapted(adaptation_run / "policy.safetensors", model)
    steps = int(read_metadata(meta_run / "model.safetensors")["env_steps"])
    used = {"meta_training": steps, "adaptation": adaptation}
    return _transfer(config, model, demonstrations, steps) + Scorer(config, demonstrations).scores(
        "reward_adaptation", config.test_environment, model, adapted, used
    )


def read_curve(run: Path, stage: str) -> list[list[float]]:
    """The learning curve of a stage; empty if the run has none."""
    file = run / "curves" / f"{stage}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else []


def read_run(run: Path) -> dict[str, Any]:
    """What a run was: its configuration, less where it stood, and the versions it ran with."""
    stored = plain(OmegaConf.create(OmegaConf.load(run / "config.yaml")))  # type: ignore[arg-type]
    versions = json.loads((run / "versions.json").read_text(encoding="utf-8"))
    return {k: v for k, v in stored.items() if k not in ("run_dir", "model_file")} | versions


def read_seconds(run: Path) -> dict[str, float]:
    """Wall-clock seconds of a run's stages."""
    file = run / "seconds.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}


@hydra.main(config_path="conf", config_name="evaluate", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    meta_run, adaptation_run = Path(config.meta_run), Path(config.adaptation_run)
    run_file(meta_run / "model.safetensors", "meta_train.py")
    run_file(adaptation_run / "policy.safetensors", "adapt_reward.py")
    evaluate(config, RunFolder(config), meta_run, adaptation_run)


if __name__ == "__main__":
    main()
