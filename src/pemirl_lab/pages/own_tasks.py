"""Tables of what was reached on tasks that are not this project's own (``results/own_tasks``)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from pemirl_lab.pages.tables import markdown_table
from pemirl_trl.evaluation import seeds_interval

COLUMNS = {
    "adapted": "adapted",
    "carried_over": "policy carried over",
    "rl_with_true_reward": "RL with the true reward",
    "expert": "expert",
    "random": "random",
}

STAGES = ("meta_training", "adaptation")
"""What a user waits for; a run may have timed more, such as the making of an expert."""


def own_task_parts(folder: Path, names: Sequence[str]) -> dict[str, str]:
    """The part of each task: true returns by seed, and the share of the gap that is closed.

    Args:
        folder: has a folder of results for each task.
        names: of the tasks.

    Raises:
        ValueError: a task has no results.
    """
    return {name: _table(folder / name) for name in names}


def _table(folder: Path) -> str:
    runs = [json.loads(file.read_text("utf-8")) for file in sorted(folder.glob("seed*.json"))]
    if not runs:
        raise ValueError(f"{folder} holds no results seed*.json")
    heading = ["seed", "gap closed", *COLUMNS.values(), "minutes"]
    mean = [_summary(runs)] if len(runs) > 1 else []  # of one seed there is no interval
    tables = [markdown_table(heading, [*map(_line, runs), *mean])]
    if all("terms" in run for run in runs):
        tables.append(markdown_table(["term of the return", *heading[1:-1]], _terms(runs)))
    return "\n".join(tables)


def _line(run: dict[str, Any]) -> list[str]:
    means = [f"{run['means'][name]:.1f}" for name in COLUMNS]
    minutes = sum(run["seconds"][stage] for stage in STAGES) / 60
    return [str(run["seed"]), f"{run['gap_closed']:.3f}", *means, f"{minutes:.1f}"]


def _summary(runs: Sequence[dict[str, Any]]) -> list[str]:
    estimate, low, high = seeds_interval([run["gap_closed"] for run in runs])
    means = (seeds_interval([run["means"][name] for run in runs]).estimate for name in COLUMNS)
    gap = f"{estimate:.3f} [{low:.3f}, {high:.3f}]"
    return ["mean", gap, *(f"{mean:.1f}" for mean in means), ""]


def _terms(runs: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Of each term that the true return is the sum of, the same figures; means of the seeds."""
    lines = []
    for term in runs[0]["terms"]:
        of = {name: fmean(run["terms"][term][name] for run in runs) for name in COLUMNS}
        gap = of["rl_with_true_reward"] - of["carried_over"]
        closed = (of["adapted"] - of["carried_over"]) / gap
        lines.append([term, f"{closed:.3f}", *(f"{value:.1f}" for value in of.values())])
    return lines
