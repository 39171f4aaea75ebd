"""One JSON file per run, one schema for all, and the tables made of them."""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch

from pemirl_trl.checkpoint import atomic_path

__all__ = [
    "SCHEMA",
    "SETTINGS",
    "Result",
    "environment_facts",
    "normalised_return",
    "read",
    "table",
]

SCHEMA = 1
SETTINGS = ("one_shot", "policy_generalisation", "reward_adaptation", "rl_with_true_reward")
_PACKAGES = (
    "pemirl-trl",
    "torch",
    "torchrl",
    "tensordict",
    "numpy",
    "mujoco",
    "dm_control",
    "gymnasium",
)
_TEXT = ("task", "variant", "method", "goals", "commit")
_MAPPINGS = ("returns", "env_steps", "seconds", "config", "versions", "hardware")
_ENV_STEPS = {"meta_training", "adaptation"}


def normalised_return(mean: float, random: float, expert: float) -> float:
    """(mean - random) / (expert - random): 0 is the random policy, 1 the expert.

    Raises:
        ValueError: the expert is no better than the random policy.
    """
    if not expert > random:
        raise ValueError(f"expert return {expert} is not above the random return {random}")
    return (mean - random) / (expert - random)


@dataclass(frozen=True, kw_only=True)
class Result:
    """What one run measured, on its last policy.

    Args:
        task: Task, such as ``point_maze``.
        variant: Dynamics under which the return was measured, such as ``left``.
        method: Method, such as ``pemirl``.
        setting: One of :data:`SETTINGS`.
        seed: Seed of the run.
        goals: Which test goals: ``all`` or a name such as ``x_in_0.1_0.4``.
        returns: ``mean`` and ``per_task``, the return of each test task, on the true reward.
        random: Mean return of the random policy on the same tasks.
        expert: Mean return of the expert on the same tasks.
        normalised: :func:`normalised_return` of the mean.
        env_steps: Environment steps of ``meta_training`` and ``adaptation``.
        seconds: Wall-clock seconds by phase.
        config: The run's whole configuration.
        versions: Version of each package.
        hardware: What it ran on.
        commit: Commit of the code, ``-dirty`` where files had been changed, or ``unknown``.
        schema: Version of this schema.
    """

    task: str
    variant: str
    method: str
    setting: str
    seed: int
    goals: str
    returns: Mapping[str, Any]
    random: float
    expert: float
    normalised: float
    env_steps: Mapping[str, int]
    seconds: Mapping[str, float]
    config: Mapping[str, Any]
    versions: Mapping[str, str]
    hardware: Mapping[str, Any]
    commit: str
    schema: int = SCHEMA

    def __post_init__(self) -> None:
        problems = [*self._type_problems()] or [*self._value_problems()]
        if problems:
            raise ValueError("not a valid result: " + "; ".join(problems))

    def _type_problems(self) -> list[str]:
        expected: dict[str, tuple[type, ...]] = {
            **dict.fromkeys(_TEXT, (str,)),
            **dict.fromkeys(_MAPPINGS, (Mapping,)),
            **dict.fromkeys(("random", "expert", "normalised"), (int, float)),
            "seed": (int,),
        }
        problems = [
            f"{name} is {value!r}, expected {types[-1].__name__.lower()}"
            for name, types in expected.items()
            if not isinstance(value := getattr(self, name), types) or isinstance(value, bool)
        ]
        if self.schema != SCHEMA:
            problems.append(f"schema is {self.schema!r}, this version reads {SCHEMA}")
        if self.setting not in SETTINGS:
            problems.append(f"setting is {self.setting!r}, expected one of {', '.join(SETTINGS)}")
        return problems

    def _value_problems(self) -> list[str]:
        if set(self.returns) != {"mean", "per_task"} or not self.returns["per_task"]:
            return [f"returns is {dict(self.returns)}, expected mean and a non-empty per_task"]
        if set(self.env_steps) != _ENV_STEPS:
            return [f"env_steps has {sorted(self.env_steps)}, expected {sorted(_ENV_STEPS)}"]
        numbers = [*self.returns["per_task"], self.returns["mean"], self.random, self.expert]
        if not all(math.isfinite(number) for number in numbers):
            return [f"returns, random and expert are {numbers}, expected finite numbers"]
        mean = math.fsum(self.returns["per_task"]) / len(self.returns["per_task"])
        derived = {
            "returns.mean": (self.returns["mean"], mean),
            "normalised": (self.normalised, normalised_return(mean, self.random, self.expert)),
        }
        return [
            f"{name} is {got}, but the other fields give {want}"
            for name, (got, want) in derived.items()
            if not math.isclose(got, want, rel_tol=1e-6, abs_tol=1e-9)
        ]

    @classmethod
    def measured(
        cls, *, per_task: Sequence[float], random: float, expert: float, **known: Any
    ) -> Result:
        """Build a result of this process: mean, normalised return and facts are filled in.

        Args:
            per_task: return of each test task.
            random: mean return of the random policy.
            expert: mean return of the expert.
            known: the other fields, less ``versions``, ``hardware`` and ``commit``.
        """
        values = [float(value) for value in per_task]
        mean = math.fsum(values) / max(len(values), 1)
        return cls(
            returns={"mean": mean, "per_task": values},
            random=random,
            expert=expert,
            normalised=normalised_return(mean, random, expert),
            **environment_facts(),
            **known,
        )

    def write(self, path: str | Path) -> None:
        """Write this result as JSON, atomically."""
        text = json.dumps(asdict(self), indent=2, allow_nan=False)
        with atomic_path(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")


def read(path: str | Path) -> Result:
    """Read a result written by :meth:`Result.write`.

    Raises:
        ValueError: not JSON, fields missing or unknown, or contents that contradict each other.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        expected = {field.name for field in fields(Result)}
        found = set(content) if isinstance(content, dict) else set()
        if found != expected:
            raise ValueError(
                f"missing fields {sorted(expected - found)}, "
                f"unknown fields {sorted(found - expected)}"
            )
        return Result(**content)
    except ValueError as error:  # json.JSONDecodeError is one too
        raise ValueError(f"{path}: {error}") from error


# --- facts about this process ------------------------------------------------------------------


def environment_facts() -> dict[str, Any]:
    """Return ``versions`` of packages, ``hardware`` and ``commit``, as in :class:`Result`."""
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue  # optional, and not installed
    hardware: dict[str, Any] = {
        "cpu": _cpu_model(),
        "cpus": os.cpu_count(),
        "torch_threads": torch.get_num_threads(),
        "platform": platform.platform(),
    }
    if torch.cuda.is_available():
        hardware["gpu"] = torch.cuda.get_device_name()
    return {"versions": versions, "hardware": hardware, "commit": _commit()}


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.processor() or platform.machine())


def _commit() -> str:
    """Commit of the repository that tracks this file; ``unknown`` for an installed package."""
    here = Path(__file__).resolve()

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(here.parent), *arguments]
        return subprocess.run(
            command, check=True, capture_output=True, text=True, timeout=10
        ).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", here.name)
        dirty = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "HEAD") + ("-dirty" if dirty else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


# --- tables ------------------------------------------------------------------------------------


def table(results: Sequence[Result]) -> str:
    """Return a Markdown table: one row per task, variant, setting and goals; methods across.

    A cell is ``mean over seeds (normalised) [every seed]``, in the order of seeds. The columns
    random and expert are what these results were normalised with.

    Raises:
        ValueError: nothing to show, or two results for one cell and seed.
    """
    if not results:
        raise ValueError("got no results; expected at least one")
    cells: dict[tuple[str, str, str], dict[str, dict[int, Result]]] = {}
    for result in results:
        row = (f"{result.task} {result.variant}", result.setting, result.goals)
        seeds = cells.setdefault(row, {}).setdefault(result.method, {})
        if result.seed in seeds:
            raise ValueError(
                f"two results for {result.method}, {', '.join(row)}, seed {result.seed}"
            )
        seeds[result.seed] = result
    methods = sorted({result.method for result in results})
    lines = [["task", "setting", "goals", "random", "expert", *methods]]
    lines.append(["---"] * len(lines[0]))
    order = {setting: place for place, setting in enumerate(SETTINGS)}
    for row in sorted(cells, key=lambda row: (order[row[1]], row)):
        there = [r for seeds in cells[row].values() for r in seeds.values()]
        references = [f"{_mean([getattr(r, k) for r in there]):.2f}" for k in ("random", "expert")]
        lines.append([*row, *references, *(_cell(cells[row].get(m, {})) for m in methods)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def _cell(seeds: Mapping[int, Result]) -> str:
    if not seeds:
        return "–"
    results = [seeds[seed] for seed in sorted(seeds)]
    means = [result.returns["mean"] for result in results]
    normalised = _mean([result.normalised for result in results])
    return f"{_mean(means):.2f} ({normalised:.3f}) [{', '.join(f'{m:.2f}' for m in means)}]"
