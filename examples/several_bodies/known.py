"""Measure the best that is known in a family's changed dynamics once more, after it has changed.

    python examples/several_bodies/known.py ant

``results/transfer/several_bodies_TASK/*.json`` then say what gap they close to it. What the other
policies returned stays as it was.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import torch
from families import FAMILIES, Family
from torchrl.envs import TransformedEnv
from transfer import EPISODES, ROOT, Experiment, gap_closed

from pemirl_envs import TaskEnv
from pemirl_trl import SampleTasks
from pemirl_trl.evaluation import whole_episodes
from pemirl_trl.files import atomic_path


def measure_known(family: Family, folder: Path) -> None:
    """Measure the best that is known once more, and the gap that stored results close to it."""
    experiment = Experiment(family, "whole", 1, 0)
    tasks = experiment.tasks("test", 1).exclude("body")
    repeated = tasks.repeat_interleave(EPISODES)
    torch.manual_seed(0)
    env = TransformedEnv(
        TaskEnv(experiment.changed, len(repeated), seed=1000, num_threads=1),
        SampleTasks(lambda count: repeated),
    )
    actor = experiment.knower(family.known())
    rollouts = whole_episodes(env, actor, experiment.changed.horizon)
    known = float(rollouts["next", "reward"].sum((1, 2)).mean())
    for file in sorted(folder.glob("*.json")):
        result = json.loads(file.read_text("utf-8"))
        # What r makes of the former one says nothing of this one.
        result["returns"]["known"] = {"true": known}
        true = {name: value["true"] for name, value in result["returns"].items()}
        result["gap_closed"] = gap_closed(true)
        with atomic_path(file) as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        logging.info("%s: known %.1f, gap closed %.3f", file.stem, known, result["gap_closed"])


def main() -> None:
    """The family of the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    names = sys.argv[1:]
    if not names or set(names) - set(FAMILIES):
        sys.exit(f"got {names}; expected some of {[*FAMILIES]}")
    for name in names:
        measure_known(FAMILIES[name], ROOT / f"results/transfer/several_bodies_{name}")


if __name__ == "__main__":
    main()
