"""What a run is made of, typed: everything that :mod:`pemirl_lab.runs.composition` resolves."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any, Literal, TypeVar

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase

import pemirl_envs
from pemirl_trl.configuration import CHECKED, Count, Index, Positive, SeedNumber, typed
from pemirl_trl.methods import AdaptationConfig, MethodConfig, PolicyOptimizationConfig
from pemirl_trl.methods.meta_training import TRAINING

Own = TypeVar("Own")


@dataclass(frozen=True, config=CHECKED)
class Evaluation:
    """Of policies: ``episodes`` per task, with environments of this ``seed``."""

    episodes: Count = 10
    seed: SeedNumber = 1000


@dataclass(frozen=True, config=CHECKED)
class Subset:
    """Which unseen tasks, by the closed range of one component of one of their parameters."""

    parameter: str
    index: Index
    low: float
    high: float

    def mask(self, tasks: TensorDictBase) -> torch.Tensor:
        """Which of ``tasks`` ``[C]`` belong to it, bool ``[C]``."""
        value = tasks[self.parameter][:, self.index]
        return (value >= self.low) & (value <= self.high)


@dataclass(frozen=True, config=CHECKED)
class ExpertPolicy:
    """The network of an expert, which reads the task.

    Attributes:
        hidden, activation: of the mean.
        scale: the deviation before training.
        standardize_task: whether it reads the task in deviations over the default split.
    """

    hidden: Sequence[Count]
    activation: Literal["relu", "tanh"]
    scale: Positive
    standardize_task: bool


@dataclass(frozen=True, config=CHECKED)
class ExpertTraining:
    """Of an expert: tasks of ``split``, drawn anew at each iteration, and so many rollouts each."""

    split: str
    tasks_per_batch: Count
    rollouts_per_task: Count
    policy: ExpertPolicy
    optimization: PolicyOptimizationConfig


@dataclass(frozen=True, config=CHECKED)
class Experiment:
    """A task with the method that suits it."""

    name: str
    task: str
    method: str


@dataclass(frozen=True, config=CHECKED)
class Settings:
    """What every command shares.

    Attributes:
        seed: of everything that is drawn.
        threads: of the simulator; results do not depend on it.
        torch_threads: of the learner. Sums of floats depend on how many share them: results are
            bit-exact for a fixed number, 1 for all that is published. More pay on idle cores alone.
        logger: of the metrics.
        checkpoint_every: iterations between checkpoints.
        run_dir: where a run writes.
        preset: ``full``, or the name of one that is not meant to be published.
        evaluation: of policies.
        task: the domain.
        environment, test_environment: dynamics of training, and the changed ones.
        confirm_environment: other changed ones, by which nothing was chosen.
        demonstrations, test_demonstrations: files.
        demonstrations_per_task: how many of each task stand in a row in the latter; one is used.
        train_split, train_per_task: whose demonstrations are drawn, and how many of each task.
        experts: files, by variant of the dynamics.
        subsets: of the unseen tasks, scored beside all of them.
        expert_training: how an expert is made.
        method: name of the method.
        learning: the method itself.
        info_estimator: ``public_code`` takes the authors' code's information term.
        adaptation: of Algorithm 2.
        experiment: which one was chosen.
        resolved: all of it as it was composed, to be stored beside results.
    """

    seed: SeedNumber
    threads: Count
    torch_threads: Count
    logger: Literal["csv", "tensorboard"] | None
    checkpoint_every: Count
    run_dir: str
    preset: str
    evaluation: Evaluation
    task: str
    environment: str
    test_environment: str
    confirm_environment: str
    demonstrations: str
    test_demonstrations: str
    demonstrations_per_task: Count
    train_split: str
    train_per_task: Count
    experts: Mapping[str, str]
    subsets: Mapping[str, Subset]
    expert_training: ExpertTraining
    method: str
    learning: MethodConfig
    info_estimator: Literal["lemma2", "public_code"]
    adaptation: AdaptationConfig
    experiment: Experiment | None = None
    resolved: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.info_estimator == "public_code" and self.learning.algorithm != "pemirl":
            raise ValueError(
                f"info_estimator=public_code is for method=pemirl and its extensions; got "
                f"method={self.method}"
            )
        for name in ("environment", "test_environment", "confirm_environment"):
            try:
                pemirl_envs.get_task(getattr(self, name))
            except ValueError as error:
                raise ValueError(f"{name}={getattr(self, name)}: {error}") from None

    @property
    def planar(self) -> bool:
        """Whether rewards are functions of a position, and can be drawn and measured over a map."""
        return pemirl_envs.get_task(self.test_environment).planar

    @property
    def task_key(self) -> str:
        """The task parameter that an expert reads."""
        return pemirl_envs.get_task(self.environment).task_key

    def expert_file(self, environment: str) -> str:
        """Where the expert of some dynamics lies.

        Raises:
            ValueError: the task names none; lists those that it names.
        """
        name = variant(environment)
        if name not in self.experts:
            raise ValueError(
                f"task={self.task} names no expert of {environment}; it has those of "
                f"{sorted(self.experts)}: add +experts.{name}=FILE"
            )
        return self.experts[name]


def variant(environment: str) -> str:
    """``"left"`` of ``"point_maze/left"``."""
    return environment.split("/")[1]


_METHOD = tuple(f.name for f in dataclasses.fields(MethodConfig))
_SHARED = tuple(
    f.name for f in dataclasses.fields(Settings) if f.name not in ("learning", "resolved")
)


def parse(resolved: Mapping[str, Any], own: type[Own]) -> tuple[Settings, Own]:
    """Typed settings of a command, and what it has of its own.

    Args:
        resolved: of :func:`pemirl_lab.runs.composition.compose`, as a dictionary.
        own: dataclass of the command's own values.

    Raises:
        ValueError: every wrong value by the name that the user gave it.
    """
    own_names = {f.name for f in dataclasses.fields(own)}  # type: ignore[arg-type]
    unknown = sorted(set(resolved) - {*_METHOD, *_SHARED, *own_names})
    if unknown:
        raise ValueError(f"unknown keys {', '.join(unknown)}")
    _check_experiment(resolved)
    shared = {name: resolved[name] for name in _SHARED if name in resolved}
    settings = typed(Settings, {**shared, "learning": _learning(resolved), "resolved": resolved})
    return settings, typed(own, {name: resolved[name] for name in own_names if name in resolved})


def _check_experiment(resolved: Mapping[str, Any]) -> None:
    """First of all: of a task and a method that do not belong together, much else is wrong too."""
    if resolved.get("experiment") is None:
        return
    chosen = typed(Experiment, resolved["experiment"], at="experiment")
    task, method = resolved["task"], resolved["method"]
    if (chosen.task, chosen.method) != (task, method):
        raise ValueError(
            f"experiment={chosen.name} is task={chosen.task} with method={chosen.method}; got "
            f"task={task} with method={method}: choose another experiment, or compose task and "
            "method freely with ~experiment"
        )


def _learning(resolved: Mapping[str, Any]) -> MethodConfig:
    values = {name: resolved[name] for name in _METHOD if name in resolved}
    if missing := [name for name in ("algorithm", "training") if name not in values]:
        raise ValueError(f"{', '.join(missing)} is missing: a method has it")
    algorithm = values["algorithm"]
    if not isinstance(algorithm, str) or algorithm not in TRAINING:
        raise ValueError(f"algorithm={algorithm}: expected one of {', '.join(TRAINING)}")
    training = typed(TRAINING[algorithm], values["training"], at="training")
    return typed(MethodConfig, {**values, "training": training})
