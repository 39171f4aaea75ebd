"""A whole proof on a task of one's own whose reward is that of a step's start.

From demonstrations to the true returns of everybody: ``examples/own_pendulum`` and
``examples/own_unicycle``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.envs import Compose, EnvBase, StepCounter, Transform, TransformedEnv

from pemirl_lab.measuring.own_proofs import (
    EPISODES,
    Proved,
    distances,
    of_contexts,
    of_tasks,
    result,
    told,
    train_on_true_reward,
    without_tasks,
)
from pemirl_trl import ContextPolicy, DemonstrationDataset, PEMIRLModel, adapt, meta_train
from pemirl_trl.evaluation import Actor, episode_returns
from pemirl_trl.methods import MakeEnv


@dataclass(frozen=True)
class StateTask:
    """A task, and what is different where the policy is to act.

    Attributes:
        name: of the results.
        horizon: T.
        make: the environment of the demonstrations; it observes ``("task", "target")`` ``[..., 2]``
            and may be reset to one.
        make_changed: the one of the new policy.
        demonstrations: so many, of a seed, with ``target`` as ground truth.
        expert: the controller that knows the target, and what has changed.
        true_reward: of observations and targets, ``[..., 1]``.
    """

    name: str
    horizon: int
    make: MakeEnv
    make_changed: MakeEnv
    demonstrations: Callable[[int, int], DemonstrationDataset]
    expert: Actor
    true_reward: Callable[[Tensor, Tensor], Tensor]

    def pile(self, seed: int) -> DemonstrationDataset:
        """What a model is trained on: 400 demonstrations, and nothing that says which targets."""
        return without_tasks(self.demonstrations(400, 10_000 + seed))


def prove(
    tasks: Sequence[StateTask],
    seed: int,
    training: Mapping[str, Any] | None = None,
    optimization: Mapping[str, Any] | None = None,
) -> Iterator[Proved]:
    """Meta-train once, adapt to each change; what it came to, in true returns per target.

    Args:
        tasks: the same demonstrations, and several changes.
        seed: of demonstrations and training.
        training, optimization: settings that differ from the defaults, for a quick look.
    """
    began, pile = time.perf_counter(), tasks[0].pile(seed)
    model = meta_train(tasks[0].make, pile, seed=seed, **(training or {}))
    spent = time.perf_counter() - began
    for task in tasks:
        found = _measure(task, model, seed, optimization, spent)
        yield Proved(found, model, pile, training or {})


def _measure(
    task: StateTask,
    model: PEMIRLModel,
    seed: int,
    optimization: Mapping[str, Any] | None,
    meta_training: float,
) -> dict[str, Any]:
    settings, new = dict(optimization or {}), task.demonstrations(10, 20_000 + seed)
    began = time.perf_counter()
    adaptation = adapt(model, without_tasks(new), task.make_changed, seed=seed, **settings)
    seconds = {"meta_training": meta_training, "adaptation": time.perf_counter() - began}
    inferred, targets = of_contexts(model, new), of_tasks(new)
    target = ("task", "target")
    oracle = train_on_true_reward(
        *(model, new),
        lambda scale, learned: ContextPolicy(
            *(model.observation_dim, model.action_dim, 2),
            activation=nn.Tanh,
            initial_scale=scale,
            learn_scale=learned,
            context_key=target,
        ),
        lambda n, at, resets: _environment(n, at, resets, task.make_changed, task.horizon),
        *(seed, settings),
        reward=task.true_reward,
        reads=("observation", target),
    )
    returns = {
        "expert": _score(task, targets, task.expert, task.make_changed),
        "random": _score(task, targets, None, task.make_changed),
        "carried_over": _score(task, inferred, model.policy, task.make_changed),
        "adapted": _score(task, inferred, adaptation.policy, task.make_changed),
        "rl_with_true_reward": _score(task, targets, oracle, task.make_changed),
        "one_shot": _score(task, inferred, model.policy, task.make),
    }
    means = {name: sum(each) / len(each) for name, each in returns.items()}
    return result(
        *(task.name, seed, means),
        per_target=returns,
        **told(adaptation),
        distances=distances(model, new),
        seconds=seconds,
    )


def _environment(n: int, seed: int, transform: Transform, make: MakeEnv, horizon: int) -> EnvBase:
    """Whole episodes of what the transform writes at reset."""
    return TransformedEnv(make(n, seed), Compose(StepCounter(horizon), transform))


def _score(task: StateTask, transform: Transform, actor: Actor, make: MakeEnv) -> list[float]:
    """True returns, one a target: the mean action, in the same episodes for all."""
    torch.manual_seed(0)
    env = _environment(10 * EPISODES, 30_000, transform.clone(), make, task.horizon)
    return episode_returns(env, actor, task.horizon, episodes_per_task=EPISODES).tolist()
