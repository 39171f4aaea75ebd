"""How an iteration's CPU time and peak memory grow with what it is given.

Meta-training with twice the contexts, twice the rollouts of each, or episodes of twice the length,
beside a base. Each in processes of its own, interleaved; the medians of CPU time count, which other
programs on the machine hardly change. The simulator and torch have one thread::

    python benchmarks/growth.py --task point_maze/left --output growth_point_maze.json
"""

from __future__ import annotations

import argparse
import pathlib
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from statistics import median
from typing import Any

from training import machine, write_json
from trainings import Setting, meta_training, peak_memory_mib

from pemirl_envs import get_task


def settings(horizon: int) -> dict[str, Setting]:
    """What is measured, for a task of that horizon."""
    base = Setting("meta-training", 25, 8, meta_training, horizon=horizon // 2)
    return {
        "base": base,
        "contexts": replace(base, contexts=2 * base.contexts),
        "rollouts": replace(base, rollouts=2 * base.rollouts),
        "horizon": replace(base, horizon=2 * (horizon // 2)),
    }


def cost(setting: Setting, name: str, method: str, iterations: int) -> tuple[float, int]:
    """CPU seconds of an iteration, and MiB at most; to be called in a fresh process."""
    training = setting.start(name, method, 1)
    seconds = []
    for _ in range(iterations):
        start = time.process_time()
        training.iteration()
        seconds.append(time.process_time() - start)
    return median(seconds), peak_memory_mib()


def report(name: str, method: str, repetitions: int, iterations: int) -> dict[str, Any]:
    """Measure every setting, ``repetitions`` times in turn."""
    chosen = settings(get_task(name).horizon)
    costs: dict[str, list[tuple[float, int]]] = {what: [] for what in chosen}
    for _ in range(repetitions):
        for what, setting in chosen.items():
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
                costs[what].append(process.submit(cost, setting, name, method, iterations).result())
    seconds = {what: median(cpu for cpu, _ in each) for what, each in costs.items()}
    memory = {what: round(median(mib for _, mib in each)) for what, each in costs.items()}
    rows = {
        what: {
            "contexts": setting.contexts,
            "rollouts": setting.rollouts,
            "horizon": setting.steps(name),
            "cpu_seconds": round(seconds[what], 3),
            "cpu_ratio": round(seconds[what] / seconds["base"], 2),
            "peak_memory_mib": memory[what],
            "memory_ratio": round(memory[what] / memory["base"], 2),
        }
        for what, setting in chosen.items()
    }
    counts = {"repetitions": repetitions, "iterations": iterations}
    return {"task": name, "method": method, **counts, "results": rows, **machine()}


def main() -> None:
    """Print the rows and, with ``--output``, write a JSON file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="point_maze/left")
    parser.add_argument("--method", default="pemirl")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--iterations", type=int, default=3, help="of each process")
    parser.add_argument("--output", type=pathlib.Path, help="a JSON file")
    arguments = parser.parse_args()
    result = report(arguments.task, arguments.method, arguments.repetitions, arguments.iterations)
    for what, row in result["results"].items():
        sys.stdout.write(f"{what:12}{row}\n")
    if arguments.output:
        write_json(arguments.output, result)


if __name__ == "__main__":
    main()
