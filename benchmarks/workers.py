"""One batch of a meta-training's rollouts from several processes of Ray, beside this process alone.

Contenders take turns, so that a change in the load meets all of them; times are divided by
that of this process with two threads in the same round, and medians over rounds count::

    python benchmarks/workers.py --experiment point_maze --rounds 9 --output workers.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import ray
import torch

from pemirl_lab.commands.meta_train import Own, open_environment, task_space
from pemirl_lab.results import environment_facts
from pemirl_lab.runs.composition import compose, plain
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.settings import parse
from pemirl_trl import DemonstrationDataset
from pemirl_trl.methods import new_model
from pemirl_trl.methods.collection import collection

CONTENDERS = (
    {"threads": 2},
    {"threads": 1},
    {"threads": 1, "workers": 1},
    {"threads": 1, "workers": 2},
)
"""What is set; the first is what others are compared with."""


def contender(experiment: str, given: dict[str, int]) -> Callable[[], float]:
    """Collects one batch, and says how long it took."""
    words = [f"experiment={experiment}", *(f"{name}={value}" for name, value in given.items())]
    settings, _ = parse(plain(compose("meta_train", words)), Own)
    demonstrations = DemonstrationDataset.load(data_file(settings.demonstrations))
    torch.manual_seed(0)
    model = new_model(demonstrations, settings.learning, task_space=task_space(settings))
    env = open_environment(settings, model, demonstrations)
    collect = collection(env, model.policy, model.horizon)

    def run() -> float:
        start = time.perf_counter()
        collect()
        return time.perf_counter() - start

    return run


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--experiment", default="point_maze")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    ray.init(num_cpus=sum(row.get("workers", 0) for row in CONTENDERS), include_dashboard=False)
    runs = [contender(given.experiment, settings) for settings in CONTENDERS]
    for run in runs:
        run()
    rounds = [[run() for run in runs] for _ in range(given.rounds)]
    rows = [
        {
            **settings,
            "speed": median(times[0] / times[i] for times in rounds),
            "seconds": median(times[i] for times in rounds),
        }
        for i, settings in enumerate(CONTENDERS)
    ]
    for row in rows:
        print(row)
    if given.output:
        record = {
            "experiment": given.experiment,
            "rounds": rounds,
            "rows": rows,
            **environment_facts(),
        }
        given.output.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
