"""Which signs of failure appear where: trainings that are known to be well, or to fail.

Each is a short run of the commands' own, and leaves the metrics that the signs read in
``results/health/<case>.json``; the table of ``docs/health.md`` and the tests judge these files, so
that another threshold needs no new run. It resumes where it was interrupted; about half an hour on
two cores::

    python benchmarks/health_signs.py
    python benchmarks/health_signs.py --cases ant_kl point_maze
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from pemirl_lab.commands.adapt_reward import adapt
from pemirl_lab.commands.meta_train import load_demonstrations, meta_train, train_meta_il
from pemirl_lab.commands.quickstart import Own
from pemirl_lab.results import environment_facts
from pemirl_lab.runs.composition import compose, plain
from pemirl_lab.runs.run_folder import RunFolder
from pemirl_lab.runs.settings import Settings, parse
from pemirl_trl import PEMIRLModel
from pemirl_trl.files import atomic_path
from pemirl_trl.health import SIGNS
from pemirl_trl.methods.health_log import read_health
from pemirl_trl.pretrained import load_model

RESULTS = Path(__file__).parents[1] / "results" / "health"
READ = {name for sign in SIGNS for name in sign.reads}
DIGITS = 6


@dataclass(frozen=True)
class Case:
    """A training.

    Attributes:
        label: what it is.
        words: of the command line.
        stage: the one that is judged, and the last that is run.
        expected: names of signs; none of a training that is well.
        model: of another case, for adaptation.
    """

    label: str
    words: tuple[str, ...]
    stage: Literal["meta-il", "meta-training", "adaptation"] = "meta-training"
    expected: tuple[str, ...] = ()
    model: str = ""


MAZE = "experiment=point_maze"
CASES = {
    "point_maze_meta_il": Case("Point-Maze, Meta-IL", (MAZE,), "meta-il"),
    "point_maze": Case("Point-Maze, `pemirl_robust`, all of it", (MAZE,)),
    "point_maze_adaptation": Case(
        "Point-Maze, adaptation, all of it", (MAZE,), "adaptation", model="point_maze"
    ),
    "ant_kl": Case(
        "Ant, Meta-IL with `meta_il.kl_coeff=0.03`",
        ("experiment=ant", "meta_il.kl_coeff=0.03"),
        "meta-il",
        ("posterior collapsed",),
    ),
    "ant_meta_il": Case("Ant, Meta-IL", ("experiment=ant",), "meta-il"),
    "ant_rescaled": Case(
        "Ant, `method=pemirl_rescaled`, 15 iterations",
        ("task=ant", "~experiment", "method=pemirl_rescaled", "training.iterations=15"),
        expected=("discriminator behind",),
    ),
    "point_maze_entropy": Case(
        "Point-Maze, learned deviation with the paper's entropy weight (`entropy_paper`)",
        (
            *(MAZE, "learn_policy_scale=true", "training.policy.final_scale=null"),
            *("training.policy.trpo.entropy_coeff=1.0", "training.iterations=30"),
        ),
        expected=("deviation runaway",),
    ),
    "point_maze_fresh_q": Case(
        "Point-Maze, q fresh and never trained",
        (
            *(MAZE, "initial_encoder=fresh", "training.encoder_lr=0"),
            *("training.info_coeff=0", "training.iterations=20"),
        ),
        expected=("posterior collapsed",),
    ),
    "point_maze_steps": Case(
        "Point-Maze, r learns far faster than the policy",
        (
            *(MAZE, "training.gradient_penalty_coeff=0", "training.batch.jitter_fraction=0"),
            *("training.reward_lr=0.01", "training.final_reward_lr=null"),
            *("training.reward_steps=40", "training.policy.trpo.max_kl=0.0001"),
            "training.iterations=20",
        ),
        expected=("discriminator saturated", "r exploding"),
    ),
    "point_maze_line": Case(
        "Point-Maze, the trust region's curvature from five transitions",
        (
            *(MAZE, "training.policy.trpo.fisher_rows=5", "training.policy.trpo.damping=1e-4"),
            *("training.policy.trpo.cg_iterations=50", "training.iterations=20"),
        ),
        expected=("line search failing",),
    ),
    "point_maze_slow": Case(
        "Point-Maze, adaptation with steps a hundredth as long",
        (
            *(MAZE, "adaptation.optimization.trpo.max_kl=1e-6"),
            "adaptation.optimization.iterations=30",
        ),
        "adaptation",
        ("policy far below its best",),
        model="point_maze",
    ),
    "sweeper": Case(
        "Sweeper, `pemirl_contrastive`, 30 iterations",
        ("experiment=sweeper", "training.iterations=30"),
    ),
    "ant": Case(
        "Ant, `pemirl_contrastive`, 12 iterations", ("experiment=ant", "training.iterations=12")
    ),
}


def run(name: str, work: Path) -> None:
    """Train a case, as far as it goes, and store what its last stage measured."""
    case = CASES[name]
    settings = settings_of(case.words, work / name)
    meta_il = shared_meta_il(settings, work)
    folder, stage = work / name, case.stage
    if case.stage == "meta-il":
        folder = meta_il_folder(settings, work)
    elif case.stage == "meta-training":
        meta_train(settings, RunFolder.of(settings), meta_il)
        stage = settings.method
    else:
        model = load_model(work / case.model / "model.safetensors")
        adapt(settings, RunFolder.of(settings), model)
    rows, _ = read_health(folder / "health" / f"{stage}.json")
    read = [
        [i, {k: float(f"{v:.{DIGITS}g}") for k, v in sorted(row.items()) if k in READ}]
        for i, row in rows
    ]
    record = {
        "label": case.label,
        "words": list(case.words),
        "stage": case.stage,
        "expected": list(case.expected),
        "rows": read,
        **environment_facts(),
    }
    with atomic_path(RESULTS / f"{name}.json") as temporary:
        temporary.write_text(json.dumps(record) + "\n", encoding="utf-8")


def settings_of(words: tuple[str, ...], run_dir: Path) -> Settings:
    """The settings of a quickstart."""
    overrides = [*words, f"run_dir={run_dir}"]
    return parse(plain(compose("quickstart", overrides)), Own)[0]


def meta_il_folder(settings: Settings, work: Path) -> Path:
    """Of the Meta-IL that cases share."""
    return work / f"meta_il_{settings.task}_{settings.learning.meta_il.kl_coeff:g}"


def shared_meta_il(settings: Settings, work: Path) -> PEMIRLModel:
    """Meta-IL's model, trained once."""
    path = meta_il_folder(settings, work)
    if (path / "meta_il.safetensors").exists():
        return load_model(path / "meta_il.safetensors")
    record = {"task": settings.task, "meta_il": str(settings.learning.meta_il)}
    folder = RunFolder(path, record, logger=None, checkpoint_every=settings.checkpoint_every)
    demonstrations = load_demonstrations(settings.demonstrations, folder)
    return train_meta_il(settings, demonstrations, folder)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--work", type=Path, default=Path("runs/health"), help="where it trains")
    given = parser.parse_args()
    torch.set_num_threads(1)
    for name in given.cases:
        run(name, given.work)


if __name__ == "__main__":
    main()
