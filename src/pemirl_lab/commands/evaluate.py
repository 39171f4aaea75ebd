"""Evaluate a meta-trained model: a table, a results file, reward maps and learning curves.

    pemirl evaluate                          # of the runs of meta_train and adapt_reward
    pemirl evaluate experiment=ant
    pemirl evaluate meta_run=... adaptation_run=...

One-shot returns on the training dynamics; policy generalisation and reward adaptation on the
changed ones. Each of the last policy, of the mean action, with m the mean of q(m | demonstration).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from pydantic.dataclasses import dataclass

from pemirl_lab.measuring.behaviours import behaviour_measures
from pemirl_lab.measuring.scores import Scorer, context_measures, load_test_demonstrations
from pemirl_lab.pages.drawing import draw_learning_curve, draw_reward_maps
from pemirl_lab.pages.tables import returns_table
from pemirl_lab.results import Result, Score, environment_facts
from pemirl_lab.runs.places import data_file, run_file
from pemirl_lab.runs.run_folder import RunFolder, read_curve, read_run, read_seconds, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.configuration import CHECKED
from pemirl_trl.files import read_metadata
from pemirl_trl.pretrained import load_model
from pemirl_trl.sharing import load_policy


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own.

    Attributes:
        results: where the results files go.
        table_name: the table that they belong to.
        meta_run, adaptation_run: of ``meta_train`` and of ``adapt_reward``.
    """

    results: str
    table_name: str
    meta_run: str
    adaptation_run: str


def run(settings: Settings, own: Own) -> list[Result]:
    """Evaluate two runs in a folder of their own."""
    meta_run, adaptation_run = Path(own.meta_run), Path(own.adaptation_run)
    run_file(meta_run / "model.safetensors", "meta_train")
    run_file(adaptation_run / "policy.safetensors", "adapt_reward")
    return evaluate(settings, own, RunFolder.of(settings))


def evaluate(settings: Settings, own: Own, folder: RunFolder) -> list[Result]:
    """Measure, write results and figures, print the table."""
    torch.manual_seed(settings.seed)
    meta_run, adaptation_run = Path(own.meta_run), Path(own.adaptation_run)
    trained = folder.reads("model", meta_run / "model.safetensors")
    folder.reads("adapted policy", adaptation_run / "policy.safetensors")
    folder.reads("test demonstrations", data_file(settings.test_demonstrations))
    model, method = load_model(trained), read_metadata(trained)["method"]
    demonstrations = load_test_demonstrations(settings)
    if demonstrations.task is None:
        say(
            f"{settings.test_demonstrations} holds no ground truth, so there is no true return to "
            "measure: the learning curves on the learned reward are in the runs' folders"
        )
        return []
    rewards = {method: context_measures(settings, model)}
    behaviours = {} if settings.planar else behaviour_measures(settings, model)
    with folder.timed("evaluation"):
        scores = {method: _scores(settings, model, demonstrations, meta_run, adaptation_run)}
        if (meta_run / "meta_il.safetensors").exists():
            meta_il = load_model(meta_run / "meta_il.safetensors")
            scores["meta_il"] = _transfer(settings, meta_il, demonstrations, 0)
            rewards["meta_il"] = context_measures(settings, meta_il)
    _tell(method, rewards, behaviours)
    rewards[method] |= behaviours
    runs = {method: meta_run, "adaptation": adaptation_run}
    results = _results(settings, own, folder, runs, scores, rewards)
    for result in results:
        result.write(Path(own.results) / f"{result.row}.json")
    say(returns_table(results))
    if settings.planar:
        name = settings.test_environment
        draw_reward_maps(name, model, demonstrations, folder.file("figures/reward_maps.png"))
    dynamics = {method: settings.environment, "adaptation": settings.test_environment}
    curves = {f"{s} on {dynamics[s]}": read_curve(run, s) for s, run in runs.items()}
    draw_learning_curve(curves, scores[method], folder.file("figures/learning_curve.png"))
    say(f"results -> {own.results}, figures -> {folder.file('figures')}")
    return results


def _tell(
    method: str, rewards: Mapping[str, Mapping[str, float]], behaviours: Mapping[str, float]
) -> None:
    for row, contexts in rewards.items():
        if contexts:
            read_off = ", ".join(f"{k.split('/')[1]} {v:.3f}" for k, v in contexts.items())
            say(f"{row}: the task, read off the contexts of held-out demonstrations: {read_off}")
    for name, value in behaviours.items():
        say(f"{method}, {name}: {value:.3f}")


def _results(
    settings: Settings,
    own: Own,
    folder: RunFolder,
    runs: Mapping[str, Path],
    scores: Mapping[str, Sequence[Score]],
    rewards: Mapping[str, dict[str, float]],
) -> list[Result]:
    """A result of each row of ``scores``; ``runs``: the run of each stage."""
    meta_run, adaptation_run = runs.values()
    config = dict(settings.resolved)
    if meta_run != folder.path:  # the quickstart is one run
        config["runs"] = {
            "meta_training": read_run(meta_run),
            "adaptation": read_run(adaptation_run),
        }
    curves = {next(iter(runs)): {stage: read_curve(run, stage) for stage, run in runs.items()}}
    return [
        Result(
            table=own.table_name,
            row=row,
            task=settings.task,
            seed=settings.seed,
            split="test",
            scores=tuple(of_row),
            curves=curves.get(row, {}),
            reward=rewards.get(row, {}),
            seconds=read_seconds(meta_run) | read_seconds(adaptation_run) | folder.seconds,
            config=config,
            **environment_facts(),
        )
        for row, of_row in scores.items()
    ]


def _transfer(
    settings: Settings, model: PEMIRLModel, demonstrations: DemonstrationDataset, steps: int
) -> list[Score]:
    """The meta-trained policy, where it was trained and where the dynamics have changed."""
    scorer = Scorer(settings, demonstrations)
    used = {"meta_training": steps, "adaptation": 0}
    where = (
        ("one_shot", settings.environment),
        ("policy_generalisation", settings.test_environment),
    )
    return [
        s for setting, env in where for s in scorer.scores(setting, env, model, model.policy, used)
    ]


def _scores(
    settings: Settings,
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    meta_run: Path,
    adaptation_run: Path,
) -> list[Score]:
    file = adaptation_run / "policy.safetensors"
    adapted, adaptation = load_policy(file, model), int(read_metadata(file)["env_steps"])
    steps = int(read_metadata(meta_run / "model.safetensors")["env_steps"])
    used = {"meta_training": steps, "adaptation": adaptation}
    scorer = Scorer(settings, demonstrations)
    where = ("reward_adaptation", settings.test_environment)
    return _transfer(settings, model, demonstrations, steps) + scorer.scores(
        *where, model, adapted, used
    )
