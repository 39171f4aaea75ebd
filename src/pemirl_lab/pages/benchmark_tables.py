"""Tables of the benchmarks' files, for the pages that :mod:`report` writes."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pemirl_lab.pages.tables import markdown_table

Benchmark = Mapping[str, Any]
"""What a benchmark wrote with ``--output``."""

STEPPED = ("environment", "environment + policy", "collector")


def _provenance(files: Mapping[str, Benchmark]) -> str:
    """One line: where and how they ran."""
    cpus = {f"{file['cpus']} CPUs" for file in files.values() if "cpus" in file}
    versions = {
        f"{package} {file['versions'][package]}"
        for file in files.values()
        for package in ("mujoco", "torch")
        if package in file["versions"]
    }
    repetitions = ", ".join(f"{task}: {file['repetitions']}" for task, file in files.items())
    loads = ", ".join(f"{task}: {file['load']}" for task, file in files.items() if "load" in file)
    busy = f"; load of the machine: {loads}" if loads else ""
    return f"{'; '.join([*sorted(cpus), *sorted(versions)])}; repetitions: {repetitions}{busy}.\n"


def stepping_table(files: Mapping[str, Benchmark]) -> str:
    """Rates of the environment and of policies in its loop, over the raw engine's."""
    chosen = {f["task"]: f for name, f in sorted(files.items()) if name.startswith("stepping_")}
    lines = [
        [
            f"`{task}`",
            str(file["num_envs"]),
            f"{file['steps_per_second']['raw engine']:,}",
            *(f"{file['ratio_to_raw_engine'][name]:.0%}" for name in STEPPED),
        ]
        for task, file in chosen.items()
    ]
    heading = ["", "simulations", "raw engine, steps/s", *STEPPED]
    return f"{markdown_table(heading, lines)}\n{_provenance(chosen)}"


def training_table(files: Mapping[str, Benchmark]) -> str:
    """Rates of whole iterations of training, over the raw engine's: a table for each domain."""
    chosen = [file for name, file in sorted(files.items()) if name.startswith("training_")]
    if not chosen:
        raise KeyError("training_<domain>.json")
    return "\n".join(map(_training_table, chosen))


def _training_table(file: Benchmark) -> str:
    lines = []
    for name, row in file["results"].items():
        parts = sorted(row.get("share_of_time", {}).items(), key=lambda part: -part[1])
        names = ("ratio_to_raw_engine", "ratio_of_cpu_time")
        ratios = [f"{row[ratio]:.0%}" if ratio in row else "" for ratio in names]
        split = ", ".join(f"{part} {share:.0%}" for part, share in parts)
        lines.append([name, f"{row['steps_per_second']:,}", *ratios, split])
    what = f"`{file['task']}`, contexts x rollouts"
    heading = [what, "steps/s", "of raw", "of raw, CPU time", "time goes to"]
    return f"{markdown_table(heading, lines)}\n{_provenance({file['task']: file})}"


def growth_table(files: Mapping[str, Benchmark]) -> str:
    """CPU time and peak memory of an iteration, given twice as much of one thing."""
    chosen = {f["task"]: f for name, f in sorted(files.items()) if name.startswith("growth_")}
    lines = [
        [
            f"`{task}`" if what == "base" else f"twice the {what}",
            *(str(row[size]) for size in ("contexts", "rollouts", "horizon")),
            f"{row['cpu_seconds']:.2f} ({row['cpu_ratio']:.2f})",
            f"{row['peak_memory_mib']} ({row['memory_ratio']:.2f})",
        ]
        for task, file in chosen.items()
        for what, row in file["results"].items()
    ]
    heading = ["", "contexts", "rollouts", "horizon", "CPU s an iteration", "peak memory, MiB"]
    return f"{markdown_table(heading, lines)}\n{_provenance(chosen)}"


def integrators_table(files: Mapping[str, Benchmark]) -> str:
    """Errors, rates and random returns of the ant's integrators."""
    file = files["integrators"]
    lines = [
        [
            name,
            f"{row['rms_qpos']:.4f}",
            f"{row['rms_qvel']:.3f}",
            f"{row['rms_torso_vx']:.3f}",
            f"{row['steps_per_cpu_second']:,.0f}",
            f"{row['random_return']:.1f} ± {row['random_return_std']:.1f}",
        ]
        for name, row in file["results"].items()
        if "rms_qpos" in row  # the others have a rate alone
    ]
    errors = ["error of pose", "error of velocities", "error of v_x, m/s"]
    heading = ["", *errors, "steps/s", "random return"]
    return f"{markdown_table(heading, lines)}\n{_provenance({file['task']: file})}"


TABLES: Mapping[str, Callable[[Mapping[str, Benchmark]], str]] = {
    "stepping": stepping_table,
    "training": training_table,
    "growth": growth_table,
    "integrators": integrators_table,
}
"""By the name of the part of a page."""


def benchmark_parts(folder: Path, names: list[str]) -> dict[str, str]:
    """The parts of a page, of the JSON files in ``folder``.

    Raises:
        ValueError: an unknown name; a file that a table needs is absent or incomplete.
    """
    if unknown := sorted(set(names) - set(TABLES)):
        raise ValueError(f"benchmark tables {unknown}; expected some of {sorted(TABLES)}")
    files = {p.stem: json.loads(p.read_text(encoding="utf-8")) for p in folder.glob("*.json")}
    try:
        return {name: TABLES[name](files) for name in names}
    except KeyError as error:
        raise ValueError(f"{folder} lacks {error}; `nox -s bench` writes its files") from error
