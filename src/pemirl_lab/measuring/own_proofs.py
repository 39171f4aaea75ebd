"""What the reward of one demonstration is worth on a task of one's own, in true returns.

The examples of tasks that are nobody's here (``examples/own_*``) share this. True returns are for
their report; no learner reads them.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.envs import EnvBase

from pemirl_lab.measuring.cards import write_page
from pemirl_lab.results import environment_facts
from pemirl_trl import (
    Adaptation,
    Card,
    DemonstrationDataset,
    InferContext,
    PEMIRLModel,
    SampleTasks,
    infer,
    save_model,
)
from pemirl_trl.evaluation import episode_returns
from pemirl_trl.files import atomic_path
from pemirl_trl.methods import PolicyOptimization, candidates, train
from pemirl_trl.methods.own_training import digest
from pemirl_trl.modules.model import Policy

EPISODES = 10
"""Of each unseen task, for the report."""


def without_tasks(demonstrations: DemonstrationDataset) -> DemonstrationDataset:
    """What a learner is given: observations, actions, and how the episodes ended."""
    return dataclasses.replace(demonstrations, task=None)


def of_contexts(model: PEMIRLModel, new: DemonstrationDataset) -> InferContext:
    """Resets to each new task ``EPISODES`` times, with the context of its demonstration."""
    return InferContext(
        model.encoder,
        new,
        rollouts_per_context=EPISODES,
        draw="all",
        sample=False,
        tasks=new.tasks(),
    )


def of_tasks(new: DemonstrationDataset, rollouts: int = EPISODES) -> SampleTasks:
    """Resets to each new task, so many times, without a context."""
    return SampleTasks(lambda count: new.tasks()[:count], rollouts_per_task=rollouts)


def distances(model: PEMIRLModel, new: DemonstrationDataset) -> list[str]:
    """How far each new demonstration is from those of training, in words."""
    one_each = without_tasks(new)
    return [str(infer(model, one_each[i]).distance) for i in range(len(new))]


def told(adaptation: Adaptation) -> dict[str, Any]:
    """What an adaptation says of itself."""
    return {
        "kept": adaptation.kept,
        "start": adaptation.start,
        "exploration": adaptation.exploration,
        "tries": dict(adaptation.tries),
        "learned_return": adaptation.learned_return,
        "carried_over_learned_return": adaptation.carried_over_return,
        "warnings": list(adaptation.warnings),
        "adaptation_env_steps": adaptation.env_steps,
    }


def train_on_true_reward(
    model: PEMIRLModel,
    new: DemonstrationDataset,
    new_policy: Callable[[float, bool], Policy],
    environment: Callable[[int, int, SampleTasks], EnvBase],
    seed: int,
    settings: Mapping[str, Any] | None = None,
    *,
    reward: Callable[..., Tensor] | None = None,
    reads: Sequence[NestedKey] = (),
) -> Policy:
    """A policy that reads the task, on the true reward, with adaptation's own settings: the oracle.

    It begins afresh, once for each exploration that adaptation may choose; what earns more is kept.

    Args:
        model: says which settings adaptation would have.
        new: demonstrations of the new tasks.
        new_policy: of the deviation (of discrete actions, the uniform share) that it begins with,
            and whether that is learned.
        environment: so many episodes of a seed, with what the transform writes at reset.
        seed: of everything random.
        settings: that differ from the defaults.
        reward: of what it ``reads``, the task last, to ``[..., 1]``; None: the environment's own.
        reads: keys.
    """
    asked: dict[str, Any] = {}
    if reward is not None:
        module = TensorDictModule(reward, list(reads), ["learned_reward"])
        asked = {"reward": module, "task_keys": (reads[-1],)}
    trained: list[tuple[float, Policy]] = []
    for way in candidates(model, new, {**(settings or {}), "initial_policy": "fresh"}):
        torch.manual_seed(seed)
        rollouts = way.config.rollouts // len(new)
        policy = new_policy(way.config.policy_scale, way.config.learn_policy_scale)
        optimization = PolicyOptimization(
            environment(len(new) * rollouts, seed, of_tasks(new, rollouts)),
            *(policy, model.horizon, way.config.optimization),
            rollouts_per_context=rollouts,
            **asked,
        )
        train(optimization)
        torch.manual_seed(seed)
        env = environment(len(new) * EPISODES, seed + 1, of_tasks(new))
        returns = episode_returns(env, policy, model.horizon, episodes_per_task=1)
        trained.append((float(returns.mean()), policy))
    return max(trained, key=lambda pair: pair[0])[1]


def words(settings: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Nested settings as words of a command."""
    found: list[str] = []
    for name, value in settings.items():
        nested = isinstance(value, Mapping)
        found += words(value, f"{prefix}{name}.") if nested else [f"{prefix}{name}={value}"]
    return found


def result(name: str, seed: int, means: Mapping[str, float], **rest: Any) -> dict[str, Any]:
    """A result as its file has it: the share of the gap that is closed, and the rest.

    Args:
        name: of the task.
        seed: of demonstrations and training.
        means: true returns; ``adapted``, ``carried_over`` and ``rl_with_true_reward`` among them.
        rest: what else there is to tell.
    """
    worst, best = means["carried_over"], means["rl_with_true_reward"]
    return {
        "task": f"own_tasks/{name}",
        "seed": seed,
        "gap_closed": (means["adapted"] - worst) / (best - worst),
        "means": dict(means),
        **rest,
        **environment_facts(),
    }


@dataclass(frozen=True)
class Proved:
    """A proof: its result, and the model it is of.

    Attributes:
        result: as its file has it.
        model: of the meta-training.
        demonstrations: that it was trained on, without tasks.
        settings: of the meta-training that differ from the defaults.
    """

    result: dict[str, Any]
    model: PEMIRLModel
    demonstrations: DemonstrationDataset
    settings: Mapping[str, Any]

    def card(self, name: str) -> Card:
        """The card of the model, by its name in the zoo."""
        versions = {**self.result["versions"], "commit": self.result["commit"]}
        return Card(
            domain=self.result["task"],
            data_sha256=digest(self.demonstrations),
            settings={"seed": self.result["seed"], **self.settings},
            measures={**self.result["means"], "gap_closed": self.result["gap_closed"]},
            licence="MIT",
            command=f"nox -s zoo -- {name}",
            versions=versions,
        )


def write_results(
    root: Path, run: Callable[[int], Iterable[Proved]], arguments: Sequence[str]
) -> None:
    """Write the results of each seed of a command line to ``root/results/<task>/seed<n>.json``.

    With ``--zoo=FILE`` the model of the first of them goes there, with its card.
    """
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)
    files = [Path(a.removeprefix("--zoo=")) for a in arguments if a.startswith("--zoo=")]
    seeds = [int(a) for a in arguments if not a.startswith("--zoo=")]
    for seed in seeds or [0]:
        for proved in run(seed):
            _store(root, proved.result)
            while files:
                file = files.pop()
                save_model(file, proved.model, card=proved.card(file.stem))
                write_page(proved.card(file.stem), file)


def _store(root: Path, found: Mapping[str, Any]) -> None:
    file = root / "results" / found["task"] / f"seed{found['seed']}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(file) as temporary:
        temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    logging.info("%s: gap closed %.3f; %s", file, found["gap_closed"], found["means"])
