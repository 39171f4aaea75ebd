"""How close is a reward to the true one? One report for any reward function of transitions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Generator, Tensor

from pemirl_trl.evaluation.reward_distance import (
    RewardFunction,
    canonicalise_epic,
    evaluate_reward,
    feasible_distance,
    independent_samples,
    pearson_distance,
    radial_basis,
    shaping_subspace,
)
from pemirl_trl.evaluation.reward_quality import (
    argmax_error,
    map_of_reward,
    spearman_with_distance,
)
from pemirl_trl.evaluation.statistics import pearson, spearman
from pemirl_trl.modules import ShapedReward

__all__ = ["Measure", "RewardReport", "reward_report", "shaped_reward_of", "state_reward_of"]

_LOWER_IS_BETTER = ("epic", "feasible", "argmax_error")
_COLUMNS = {
    "spearman": "Spearman",
    "pearson": "Pearson",
    "epic": "EPIC",
    "feasible": "feasible distance",
    "argmax_error": "argmax error, m",
}
_OF_A_CONSTANT = {"spearman": 0.0, "pearson": 0.0, "epic": 0.5**0.5, "feasible": 0.5**0.5}


class Measure(NamedTuple):
    """What was measured: which reward, on which coverage distribution (or ``map``), and how."""

    reward: str
    where: str
    metric: str


@dataclass(frozen=True)
class RewardReport:
    """Measures of rewards against the true one, task by task; see :func:`reward_report`.

    Args:
        per_task: ``[C]`` of each measure.
    """

    per_task: Mapping[Measure, Tensor]

    def summary(self) -> dict[str, float]:
        """Mean and worst over tasks, by names such as ``r/expert/spearman/mean``; all finite."""
        summary = {}
        for measure, values in self.per_task.items():
            name = "/".join(measure)
            summary[f"{name}/mean"], summary[f"{name}/worst"] = _mean_and_worst(measure, values)
        return summary

    def table(self) -> list[list[str]]:
        """A head, and rows of means over tasks, the worst task's in parentheses."""
        places = dict.fromkeys((measure.reward, measure.where) for measure in self.per_task)
        lines = [["reward", "on", *_COLUMNS.values()]]
        for place in places:
            measures = (Measure(*place, metric) for metric in _COLUMNS)
            lines.append([*place, *(self._cell(measure) for measure in measures)])
        return lines

    def by_metric(self) -> dict[str, dict[str, Tensor]]:
        """Heading of each metric to what was measured, such as ``r on expert``, to ``[C]``."""
        found: dict[str, dict[str, Tensor]] = {}
        for metric, heading in _COLUMNS.items():
            for measure, values in self.per_task.items():
                if measure.metric == metric:
                    found.setdefault(heading, {})[f"{measure.reward} on {measure.where}"] = values
        return found

    def markdown(self) -> str:
        """The table as Markdown."""
        head, *rows = self.table()
        lines = [head, ["---"] * len(head), *rows]
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)

    def _cell(self, measure: Measure) -> str:
        if measure not in self.per_task:
            return "–"
        mean, worst = _mean_and_worst(measure, self.per_task[measure])
        return f"{mean:.3f} ({worst:.3f})"


def reward_report(
    rewards: Mapping[str, RewardFunction],
    true: RewardFunction | None,
    coverage: Mapping[str, TensorDictBase],
    *,
    gamma: float,
    positions: Tensor | None = None,
    goals: Tensor | None = None,
    epic_transitions: int = 128,
    epic_samples: int = 64,
    features: int = 64,
    seed: int = 0,
) -> RewardReport:
    """Measure rewards against the true one.

    On every coverage distribution: the rank and the linear correlation of the rewards as they are,
    :func:`~pemirl_trl.evaluation.reward_distance.epic_distance` and
    :func:`~pemirl_trl.evaluation.reward_distance.feasible_distance`. On a map, at rest (see
    :func:`~pemirl_trl.evaluation.reward_quality.map_of_reward`): the rank correlation with minus
    the distance to the goal, and the distance from the map's maximum to the goal, in metres.
    A reward that is constant, and so prefers nothing, counts as unrelated to the true one:
    correlation 0, distance sqrt(1/2).

    Args:
        rewards: by name, such as r and f of one model.
        true: the true reward, where EPIC asks for those of transitions that never happened; None
            leaves EPIC out.
        coverage: by name, transitions ``[C, B]``, see
            :data:`~pemirl_trl.evaluation.reward_distance.RewardFunction`. Where they hold
            ``("next", "reward")``, that is the true reward of what happened. B must be at least
            4 times the number of features.
        gamma: discount of the shaping that distances do not see.
        positions: grid of the maps ``[H, W, 2]`` in metres; None: no maps.
        goals: ``[C, 2]`` in metres, with ``positions``.
        epic_transitions: how many of the B transitions EPIC is measured on; its cost is this times
            ``epic_samples``.
        epic_samples: independent (S, A, S') in its expectations.
        features: radial functions that potentials are made of in the feasible distance.
        seed: of the draws.

    Raises:
        ValueError: no coverage, a coverage named ``map``, or one of positions and goals alone; or
            neither a true reward nor stored ones.
    """
    if not coverage or "map" in coverage or (positions is None) != (goals is None):
        raise ValueError(
            f"got coverage {sorted(coverage)}, positions: {positions is not None}, goals: "
            f"{goals is not None}; expected some coverage, none of it named 'map', and both or none"
        )
    generator = Generator().manual_seed(seed)
    per_task: dict[Measure, Tensor] = {}
    for where, transitions in coverage.items():
        some = torch.randperm(transitions.shape[1], generator=generator)[:epic_transitions]
        samples = independent_samples(transitions, epic_samples, generator)
        basis = radial_basis(transitions["observation"], features, generator)
        epic = partial(
            canonicalise_epic, transitions=transitions[:, some], samples=samples, gamma=gamma
        )
        measured = _on_transitions(rewards, true, transitions, epic, basis, gamma)
        per_task |= {Measure(name, where, metric): v for (name, metric), v in measured.items()}
    if positions is not None and goals is not None:
        like = next(iter(coverage.values()))
        for name, reward in rewards.items():
            image = map_of_reward(reward, like, positions)
            ranks = spearman_with_distance(image, positions, goals)
            per_task[Measure(name, "map", "spearman")] = ranks
            per_task[Measure(name, "map", "argmax_error")] = argmax_error(image, positions, goals)
    return RewardReport(
        {m: v.double().nan_to_num(_OF_A_CONSTANT.get(m.metric)) for m, v in per_task.items()}
    )


def state_reward_of(module: ShapedReward) -> RewardFunction:
    """The learned reward r(s, m) alone, of transitions that carry a ``context``."""
    return lambda batch: module.reward(batch[module.observation_key], batch[module.context_key])


def shaped_reward_of(module: ShapedReward) -> RewardFunction:
    """f(s, a, s', m) = r + gamma h' - h, of transitions that carry a ``context``."""
    return lambda batch: module(batch.select(*module.in_keys))[module.shaped_reward_key]


def _on_transitions(
    rewards: Mapping[str, RewardFunction],
    true: RewardFunction | None,
    transitions: TensorDictBase,
    epic: Callable[[RewardFunction], Tensor],
    basis: Callable[[Tensor], Tensor],
    gamma: float,
) -> dict[tuple[str, str], Tensor]:
    """Each metric ``[C]`` of each reward, by the names of both.

    ``epic`` gives a reward's canonical form, ``basis`` the functions that potentials are made of.
    """
    truth, true_form = _true_rewards(true, transitions), None if true is None else epic(true)
    here, there = transitions["observation"], transitions["next", "observation"]
    shaping = shaping_subspace(basis(here), basis(there), gamma)
    measured: dict[tuple[str, str], Tensor] = {}
    for name, reward in rewards.items():
        values = evaluate_reward(reward, transitions)
        measured |= {
            (name, "spearman"): spearman(values, truth),
            (name, "pearson"): pearson(values, truth),
        }
        if true_form is not None:
            measured[name, "epic"] = pearson_distance(epic(reward), true_form)
        measured[name, "feasible"] = feasible_distance(values, truth, shaping)
    return measured


def _true_rewards(true: RewardFunction | None, transitions: TensorDictBase) -> Tensor:
    stored = transitions.get(("next", "reward"), None)
    reward = true if stored is None else (lambda _: stored)
    if reward is None:
        raise ValueError("got no true reward, and transitions without ('next', 'reward')")
    return evaluate_reward(reward, transitions)


def _mean_and_worst(measure: Measure, values: Tensor) -> tuple[float, float]:
    worst = values.max() if measure.metric in _LOWER_IS_BETTER else values.min()
    return math.fsum(values.tolist()) / len(values), float(worst)
