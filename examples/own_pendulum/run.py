"""One demonstration in, its reward out: the pendulum of pendulum.py, with the library's defaults.

``python examples/own_pendulum/run.py 0 1 2`` writes ``results/own_tasks/pendulum/seed<n>.json`` for
each seed, some minutes each: the motor is reversed. ``run.py light 0 1 2`` is for a quarter of the
mass (``pendulum_light``). True returns are for this report; no learner reads them.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pendulum as task
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import Compose, EnvBase, StepCounter, Transform, TransformedEnv

from pemirl_lab.results import environment_facts
from pemirl_trl import (
    ContextPolicy,
    DemonstrationDataset,
    InferContext,
    PEMIRLModel,
    SampleTasks,
    adapt,
    infer,
    meta_train,
)
from pemirl_trl.evaluation import Actor, episode_returns
from pemirl_trl.files import atomic_path
from pemirl_trl.methods import MakeEnv, PolicyOptimization, adaptation_config, train

RESULTS = Path(__file__).parents[2] / "results" / "own_tasks"
EPISODES = 10  # of each unseen target, for the report


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
    one_each = without_tasks(new)
    adaptation = adapt(model, one_each, change.make, seed=seed, **optimization)
    seconds = {"meta_training": meta_training, "adaptation": time.perf_counter() - trained}
    inferred = InferContext(
        model.encoder,
        new,
        rollouts_per_context=EPISODES,
        draw="all",
        sample=False,
        tasks=new.tasks(),
    )
    targets = SampleTasks(lambda count: new.tasks()[:count], rollouts_per_task=EPISODES)
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
    worst, best = means["carried_over"], means["rl_with_true_reward"]
    return {
        "task": f"own_tasks/{change.name}",
        "seed": seed,
        "gap_closed": (means["adapted"] - worst) / (best - worst),
        "means": means,
        "per_target": returns,
        "kept": adaptation.kept,
        "start": adaptation.start,
        "tries": dict(adaptation.tries),
        "learned_return": adaptation.learned_return,
        "carried_over_learned_return": adaptation.carried_over_return,
        "warnings": list(adaptation.warnings),
        "distances": [str(infer(model, one_each[i]).distance) for i in range(len(new))],
        "adaptation_env_steps": adaptation.env_steps,
        "seconds": seconds,
        **environment_facts(),
    }


def without_tasks(demonstrations: DemonstrationDataset) -> DemonstrationDataset:
    """What a learner is given: observations and actions."""
    return DemonstrationDataset(demonstrations.observation, demonstrations.action)


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
    targets = SampleTasks(lambda count: new.tasks()[:count], rollouts_per_task=rollouts)
    target = ("task", "target")
    policy = ContextPolicy(
        *(3, 1, 2),
        activation=nn.Tanh,
        initial_scale=config.policy_scale,
        learn_scale=False,
        context_key=target,
    )

    def reward(observation: Tensor, target: Tensor) -> Tensor:
        return task.true_reward(observation, target)

    method = PolicyOptimization(
        environment(len(new) * rollouts, seed, targets, make),
        policy,
        task.T,
        config.optimization,
        rollouts_per_context=rollouts,
        reward=TensorDictModule(reward, ["observation", target], ["learned_reward"]),
        task_keys=(target,),
    )
    train(method)
    return policy


def main() -> None:
    """A result for each seed of the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)
    light = "light" in sys.argv[1:]
    change = LIGHT if light else REVERSED
    folder = RESULTS / change.name
    for seed in map(int, sys.argv[2 if light else 1 :] or ["0"]):
        result = run(seed, {}, {}, change)
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder / f"seed{seed}.json") as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        logging.info("seed %d: gap closed %.3f; %s", seed, result["gap_closed"], result["means"])


if __name__ == "__main__":
    main()
