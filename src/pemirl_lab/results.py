"""One JSON file per run, one schema for all."""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import torch

from pemirl_trl.files import atomic_path

__all__ = [
    "SCHEMA",
    "SETTINGS",
    "Result",
    "Score",
    "environment_facts",
    "normalised_return",
    "read",
    "read_all",
]

SCHEMA = 2
"""Version of the files' format."""
SETTINGS = (
    "one_shot",
    "policy_generalisation",
    "reward_adaptation",
    "rl_with_true_reward",
    "expert",
)
"""What was measured: the meta-trained policy under the dynamics of training, or carried over to
others; a new policy trained on the learned reward (under the dynamics of training that is
self-transfer), or on the true one; an expert, which knows the task, where it was trained."""
_PACKAGES = (
    "pemirl-trl",
    "torch",
    "torchrl",
    "tensordict",
    "numpy",
    "scipy",
    "mujoco",
    "dm_control",
    "gymnasium",
)
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
class Score:
    """The true returns of one policy over unseen tasks.

    Args:
        variant: dynamics under which they were measured, such as ``left``.
        setting: one of :data:`SETTINGS`.
        goals: which tasks of the split: ``all`` or a name such as ``x_in_0.1_0.4``.
        per_task: return of each task.
        random: mean return of the random policy on the same tasks.
        expert: mean return of the expert on the same tasks.
        env_steps: environment steps of ``meta_training`` and ``adaptation``.
        mean, normalised: of ``per_task``; filled in, and checked when they are given.
    """

    variant: str
    setting: str
    goals: str
    per_task: tuple[float, ...]
    random: float
    expert: float
    env_steps: Mapping[str, int]
    mean: float = math.nan
    normalised: float = math.nan

    def __post_init__(self) -> None:
        object.__setattr__(self, "per_task", tuple(float(value) for value in self.per_task))
        problems = list(self._problems())
        if problems:
            raise ValueError("not a valid score: " + "; ".join(problems))
        mean = math.fsum(self.per_task) / len(self.per_task)
        derived = {"mean": mean, "normalised": normalised_return(mean, self.random, self.expert)}
        for name, value in derived.items():
            given = getattr(self, name)
            if not math.isnan(given) and not math.isclose(given, value, rel_tol=1e-6, abs_tol=1e-9):
                raise ValueError(
                    f"not a valid score: {name} is {given}, but the other fields give {value}"
                )
            object.__setattr__(self, name, value)

    def _problems(self) -> Sequence[str]:
        problems = []
        if self.setting not in SETTINGS:
            problems.append(f"setting is {self.setting!r}, expected one of {', '.join(SETTINGS)}")
        if set(self.env_steps) != _ENV_STEPS:
            problems.append(
                f"env_steps has {sorted(self.env_steps)}, expected {sorted(_ENV_STEPS)}"
            )
        numbers = (*self.per_task, self.random, self.expert)
        if not self.per_task or not all(math.isfinite(number) for number in numbers):
            problems.append(
                f"per_task, random and expert are {numbers}, expected finite numbers and a task"
            )
        return problems


@dataclass(frozen=True, kw_only=True)
class Result:
    """What one run measured, on its last policy.

    Args:
        table: the comparison that the run belongs to, such as ``point_maze``.
        row: the named configuration within it, such as ``pemirl``.
        task: domain, such as ``point_maze``.
        seed: seed of the run.
        split: which unseen tasks: ``test``, or ``validation`` where settings are chosen.
        scores: returns, by setting, dynamics and goals.
        reward: measures of the learned reward, and of the contexts that it reads (``context/...``),
            by name; empty where there is none.
        curves: ``(environment steps, true return)`` over training, by stage.
        seconds: wall-clock seconds by stage.
        config: the run's whole configuration.
        versions: version of each package.
        hardware: what it ran on.
        commit: commit of the code, ``-dirty`` where files had been changed, or ``unknown``.
        schema: version of this schema.
    """

    table: str
    row: str
    task: str
    seed: int
    split: str
    scores: tuple[Score, ...]
    reward: Mapping[str, float] = field(default_factory=dict)
    curves: Mapping[str, Sequence[Sequence[float]]] = field(default_factory=dict)
    seconds: Mapping[str, float]
    config: Mapping[str, Any]
    versions: Mapping[str, str]
    hardware: Mapping[str, Any]
    commit: str
    schema: int = SCHEMA

    def __post_init__(self) -> None:
        problems = [
            f"{name} is {value!r}, expected a string"
            for name in ("table", "row", "task", "split", "commit")
            if not isinstance(value := getattr(self, name), str)
        ]
        if not isinstance(self.seed, int) or isinstance(self.seed, bool):
            problems.append(f"seed is {self.seed!r}, expected an integer")
        if self.schema != SCHEMA:
            problems.append(f"schema is {self.schema!r}, this version reads {SCHEMA}")
        keys = [(score.setting, score.variant, score.goals) for score in self.scores]
        if not keys or len(set(keys)) != len(keys):
            problems.append(f"scores are of {keys}, expected at least one, and each once")
        if not all(math.isfinite(value) for value in self.reward.values()):
            problems.append(f"reward is {dict(self.reward)}, expected finite numbers")
        if problems:
            raise ValueError("not a valid result: " + "; ".join(problems))

    def score(self, setting: str, variant: str, goals: str = "all") -> Score | None:
        """The score of a setting, dynamics and set of goals, or None if it was not measured."""
        for score in self.scores:
            if (score.setting, score.variant, score.goals) == (setting, variant, goals):
                return score
        return None

    def write(self, path: str | Path) -> None:
        """Write this result as JSON, atomically."""
        text = json.dumps(asdict(self), indent=1, allow_nan=False)
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
        scores = tuple(Score(**score) for score in content.pop("scores"))
        return Result(scores=scores, **content)
    except (ValueError, TypeError) as error:  # json.JSONDecodeError is a ValueError too
        raise ValueError(f"{path}: {error}") from error


def read_all(directory: str | Path) -> list[Result]:
    """Read every result below a directory, in the order of their paths."""
    return [read(path) for path in sorted(Path(directory).rglob("*.json"))]


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
