"""Run the rows of a table over seeds: the paper's experiments, the baselines, the ablations.

    pemirl reproduce table=point_maze                               # every row, every seed
    pemirl reproduce table=ablations row=base,info_none seed=0,1    # some of it
    pemirl reproduce table=ant hydra.launcher.n_jobs=4              # so many side by side
    pemirl reproduce table=ant --list                               # the commands, one a job
    pemirl reproduce table=ant hydra/launcher=submitit_slurm        # hydra-submitit-launcher
    pemirl reproduce table=ant hydra/launcher=ray                   # hydra-ray-launcher
    pemirl reproduce table=ant confirm=true                         # at the end, once

Each seed has its own demonstrations and its own Meta-IL, which all its rows share. A job writes
``results/TABLE/ROW/seedN.json``; the same command does what is missing, and resumes what died.
``pemirl report --write`` turns the files into pages. With ``confirm=true`` the same trained model
is also measured on tasks, and under a shift, by which nothing was chosen:
``results/TABLE_confirm/ROW/seedN.json``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

from filelock import FileLock
from pydantic.dataclasses import dataclass

from pemirl_lab.commands import collect_demos
from pemirl_lab.commands.adapt_reward import adapt
from pemirl_lab.commands.meta_train import load_demonstrations, meta_train, train_meta_il
from pemirl_lab.measuring.behaviours import behaviour_measures
from pemirl_lab.measuring.candidates import of_model
from pemirl_lab.measuring.learned_rewards import ReportConfig, measure_reward
from pemirl_lab.measuring.scores import Scorer, context_measures, load_test_demonstrations
from pemirl_lab.results import Result, Score, environment_facts, read
from pemirl_lab.runs.run_folder import FREE, RunFolder, read_curve, read_seconds, say
from pemirl_lab.runs.settings import Settings, variant
from pemirl_lab.runs.validation import changed_settings
from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.configuration import CHECKED, Count
from pemirl_trl.files import read_metadata

Setting = Literal["one_shot", "policy_generalisation", "reward_adaptation", "rl_with_true_reward"]


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own.

    Attributes:
        table, row: which experiment.
        seeds: how many it has.
        results: where its result goes.
        shared_dir: where the demonstrations and Meta-IL of a seed lie, which its rows share.
        test_split: which unseen tasks.
        measure: under which dynamics each setting is scored.
        measure_reward: whether the reward is measured against the true one over a map.
        confirm: whether the trained model is measured once more: on the tasks of the split
            ``confirm``, and under ``confirm_environment`` in place of the test's dynamics.
        demonstrators: files of the experts that demonstrate, by turns; None: the environment's.
    """

    table: str
    row: str
    seeds: Count
    results: str
    shared_dir: str
    test_split: Literal["test", "validation", "confirm"]
    measure: Mapping[Setting, Sequence[str]]
    measure_reward: bool
    confirm: bool
    demonstrators: list[str] | None = None


def run(settings: Settings, own: Own) -> Result | None:
    """One row, one seed: demonstrations, Meta-IL, the method, its policies, their scores."""
    if settings.seed >= own.seeds:
        say(f"{own.row}, seed {settings.seed}: nothing to do")
        return None
    parts = [(settings, own), *([confirming(settings, own)] if own.confirm else [])]
    missing = [part for part in parts if not output(*part).exists()]
    if not missing:
        told = stored_otherwise(settings, output(settings, own))
        say(f"{own.row}, seed {settings.seed}: nothing to do{told}")
        return None
    for part in missing:
        draw_demonstrations(*part)
    meta_il, meta_il_run = shared_meta_il(settings, own)
    folder = RunFolder.of(settings)
    model = meta_train(settings, folder, meta_il)
    for given, its in missing:
        where = folder if given is settings else RunFolder.of(given)
        seconds = read_seconds(meta_il_run) | read_seconds(folder.path)
        result = measured(given, its, where, model, folder.file("model.safetensors"), seconds)
        result.write(output(given, its))
        say(f"{its.row}, seed {given.seed} -> {output(given, its)}")
    return result


def output(settings: Settings, own: Own) -> Path:
    """Where the result of a seed goes."""
    return Path(own.results) / f"seed{settings.seed}.json"


def confirming(settings: Settings, own: Own) -> tuple[Settings, Own]:
    """The same run, measured on what nothing was chosen by."""
    tested, now = settings.test_environment, settings.confirm_environment
    moved = {
        setting: [now if name == tested else name for name in names]
        for setting, names in own.measure.items()
    }
    demonstrations = Path(settings.test_demonstrations).with_name("confirm.safetensors")
    given: dict[str, Any] = {
        "run_dir": f"{settings.run_dir}/confirm",
        "test_environment": now,
        "test_demonstrations": str(demonstrations),
    }
    table = f"{Path(own.table).stem}_confirm"
    results = Path(own.results).parent.with_name(table) / own.row
    its: dict[str, Any] = {
        "table": table,
        "results": str(results),
        "test_split": "confirm",
        "measure": moved,
    }
    resolved = {**settings.resolved, **given, **its}
    return replace(settings, **given, resolved=resolved), replace(own, **its)


def measured(
    settings: Settings,
    own: Own,
    folder: RunFolder,
    model: PEMIRLModel,
    trained: Path,
    before: Mapping[str, float],
) -> Result:
    """Everything that is measured of a trained model.

    Args:
        settings: of the run.
        own: say what is measured.
        folder: where new policies are trained.
        model: what was trained.
        trained: its file, which says how long; there is none of Meta-IL's own.
        before: the seconds that training took, by stage.
    """
    demonstrations = load_test_demonstrations(settings)
    steps = int(read_metadata(trained)["env_steps"]) if trained.exists() else 0
    scores = measure(settings, own, folder, model, demonstrations, steps)
    reward = context_measures(settings, model)
    if not settings.planar and own.measure.get("reward_adaptation"):
        reward |= behaviour_measures(settings, model)
    if own.measure_reward:
        with folder.timed("reward_report"):
            report = measure_reward(
                settings, ReportConfig(), of_model(model, demonstrations), demonstrations
            )
            reward |= report.summary()
    stages = sorted(file.stem for file in folder.file("curves").glob("*.json"))
    return Result(
        table=Path(own.table).stem,
        row=own.row,
        task=settings.task,
        seed=settings.seed,
        split=own.test_split,
        scores=tuple(scores),
        reward=reward,
        curves={stage: read_curve(folder.path, stage) for stage in stages},
        seconds={**before, **read_seconds(folder.path)},
        config=dict(settings.resolved),
        **environment_facts(),
    )


def stored_otherwise(settings: Settings, output: Path) -> str:
    """Which settings of a stored result are not those of now; what runs it with them."""
    if not output.exists():
        return ""
    changed = changed_settings(read(output).config, settings.resolved, ignore=FREE)
    return f"; stored with {', '.join(changed)}: delete {output} to run it anew" if changed else ""


def measure(
    settings: Settings,
    own: Own,
    folder: RunFolder,
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    steps: int,
) -> list[Score]:
    """Scores of all settings and dynamics that the row asks for; ``steps`` trained the model."""
    scorer = Scorer(settings, demonstrations)
    scores = []
    for setting, environments in own.measure.items():
        for name in environments:
            policy, adaptation = model.policy, 0
            if setting in ("reward_adaptation", "rl_with_true_reward"):
                policy, adaptation = adapt(
                    settings,
                    folder,
                    model,
                    environment_name=name,
                    stage=f"{setting}-{variant(name)}",
                    true_reward=setting == "rl_with_true_reward",
                )
            used = {"meta_training": steps, "adaptation": adaptation}
            with folder.timed("evaluation"):
                scores += scorer.scores(setting, name, model, policy, used)
    return scores


def draw_demonstrations(settings: Settings, own: Own) -> None:
    """This seed's own demonstrations of the training and of the unseen tasks."""
    wanted = {
        settings.demonstrations: (settings.train_split, settings.train_per_task),
        settings.test_demonstrations: (own.test_split, settings.demonstrations_per_task),
    }
    for output, (split, per_task) in wanted.items():
        Path(output).parent.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{output}.lock"):
            if not Path(output).exists():
                chosen = collect_demos.Own(
                    split=split, per_task=per_task, output=output, expert=own.demonstrators
                )
                collect_demos.run(settings, chosen)


def shared_meta_il(settings: Settings, own: Own) -> tuple[PEMIRLModel | None, Path]:
    """Meta-IL's model, trained once for all rows that start from the same; and its folder.

    None for a method without contexts.
    """
    learning = settings.learning
    if learning.model.context_dim == 0:
        return None, Path(settings.run_dir)
    # It has no use for the reward, whatever its kind.
    model = replace(learning.model, reward="shaped", reward_features=None)
    record = {
        "seed": settings.seed,
        "environment": settings.environment,
        "demonstrations": settings.demonstrations,
        "meta_il": asdict(learning.meta_il),
        "model": {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(model).items()},
        "preset": settings.preset,
    }
    name = hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:12]
    run_dir = Path(own.shared_dir) / "meta_il" / f"{name}-seed{settings.seed}"
    run_dir.mkdir(parents=True, exist_ok=True)
    with FileLock(run_dir / "shared.lock"):  # the second of two rows waits for the first
        folder = RunFolder(
            run_dir,
            record,
            logger=settings.logger,
            checkpoint_every=settings.checkpoint_every,
        )
        demonstrations = load_demonstrations(settings.demonstrations, folder)
        trained = train_meta_il(settings, demonstrations, folder)
        folder.release()
        return trained, run_dir
