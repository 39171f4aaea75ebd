"""One demonstration in, its reward out: the pendulum of pendulum.py, with the library's defaults.

``python examples/own_pendulum/run.py 0 1 2`` writes ``results/own_tasks/pendulum/seed<n>.json`` for
each seed, some minutes each: the motor is reversed. ``run.py light 0 1 2`` is for a quarter of the
mass (``pendulum_light``). True returns are for this report; no learner reads them.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pendulum as task
import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import Compose, EnvBase, StepCounter, Transform, TransformedEnv

from pemirl_lab.measuring.own_proofs import (
    EPISODES,
    distances,
    of_contexts,
    of_tasks,
    result,
    told,
    train_on_true_reward,
    without_tasks,
    write_results,
)
from pemirl_trl import (
    ContextPolicy,
    DemonstrationDataset,
    PEMIRLModel,
    adapt,
    meta_train,
)
from pemirl_trl.evaluation import Actor, episode_returns
from pemirl_trl.methods import MakeEnv, adaptation_config

RESULTS = Path(__file__).parents[2] / "results" / "own_tasks"


@dataclass(frozen=True)
class Change:
    """What is different where the policy is to act."""

    name: str
    make: MakeEnv
    motor: float = 1.0
    mass: float = task.MASS


REVERSED = Change("pendulum", task.make_reversed, motor=-1.0)
LIGHT = Change("pendulum_light", task.make_light, mass=task.LIGHT)


def run(
    seed: int,
    training: dict[str, Any],
    optimization: dict[str, Any],
    change: Change = REVERSED,
) -> dict[str, Any]:
    """Meta-train, infer and adapt; what it came to, in true returns per target.

    Args:
        seed: of demonstrations and training.
        training, optimization: settings that differ from the defaults, for a quick look.
        change: what is different afterwards.
    """
    began = time.perf_counter()
    model = meta_train(task.make, pile(seed), seed=seed, **training)
    return measure(model, seed, optimization, time.perf_counter() - began, change)


def pile(seed: int) -> DemonstrationDataset:
    """What a model is trained on: 400 demonstrations, and nothing that says of which targets."""
    return without_tasks(task.demonstrations(400, seed=10_000 + seed))


def measure(
    model: PEMIRLModel,
    seed: int,
    optimization: dict[str, Any],
    meta_training: float,
    change: Change = REVERSED,
) -> dict[str, Any]:
    """Adapt a model, and score it; ``meta_training``: the seconds that it took."""
    new = task.demonstrations(10, seed=20_000 + seed)
    trained = time.perf_counter()
    adaptation = adapt(model, without_tasks(new), change.make, seed=seed, **optimization)
    seconds = {"meta_training": meta_training, "adaptation": time.perf_counter() - trained}
    inferred, targets = of_contexts(model, new), of_tasks(new)
    oracle = reinforcement_learning(model, new, seed, optimization, change.make)
    returns = {
        "expert": score(targets, expert(change), change.make),
        "random": score(targets, None, change.make),
        "carried_over": score(inferred, model.policy, change.make),
        "adapted": score(inferred, adaptation.policy, change.make),
        "rl_with_true_reward": score(targets, oracle, change.make),
        "one_shot": score(inferred, model.policy, task.make),
    }
    means = {name: sum(each) / len(each) for name, each in returns.items()}
    return result(
        *(change.name, seed, means),
        per_target=returns,
        **told(adaptation),
        distances=distances(model, new),
        seconds=seconds,
    )


def environment(n: int, seed: int, transform: Transform, make: MakeEnv) -> EnvBase:
    """Whole episodes of what the transform writes at reset."""
    return TransformedEnv(make(n, seed), Compose(StepCounter(task.T), transform))


def expert(change: Change) -> Actor:
    """The controller that knows the target, and what has changed."""

    def act(td: TensorDictBase) -> TensorDictBase:
        state, target = td["observation"], td["task", "target"]
        return td.set("action", task.controller(state, target, change.motor, change.mass))

    return act


def score(transform: Transform, actor: Actor, make: MakeEnv) -> list[float]:
    """True returns, one a target: the mean action, in the same episodes for all."""
    torch.manual_seed(0)
    env = environment(10 * EPISODES, 30_000, transform.clone(), make)
    return episode_returns(env, actor, task.T, episodes_per_task=EPISODES).tolist()


def reinforcement_learning(
    model: PEMIRLModel,
    new: DemonstrationDataset,
    seed: int,
    settings: dict[str, Any],
    make: MakeEnv,
) -> ContextPolicy:
    """A policy that reads the target, on the true reward, with adaptation's own settings."""
    torch.manual_seed(seed)
    config = adaptation_config(model, new, settings)
    rollouts = config.rollouts // len(new)
    target = ("task", "target")
    policy = ContextPolicy(
        *(3, 1, 2),
        activation=nn.Tanh,
        initial_scale=config.policy_scale,
        learn_scale=False,
        context_key=target,
    )
    train_on_true_reward(
        policy,
        environment(len(new) * rollouts, seed, of_tasks(new, rollouts), make),
        task.T,
        config.optimization,
        rollouts=rollouts,
        reward=task.true_reward,
        task_key=target,
    )
    return policy


def main() -> None:
    """A result for each seed of the command line."""
    light = "light" in sys.argv[1:]
    change = LIGHT if light else REVERSED
    seeds = sys.argv[2 if light else 1 :]
    write_results(RESULTS / change.name, lambda seed: run(seed, {}, {}, change), seeds)


if __name__ == "__main__":
    main()
