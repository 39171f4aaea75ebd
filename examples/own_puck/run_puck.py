"""One demonstration in, its reward out: the puck of puck.py, with the library's defaults.

``python examples/own_puck/run_puck.py 0 1 2`` writes ``results/own_tasks/puck/seed<n>.json`` for
each seed, some minutes each. True returns are for this report; no learner reads them.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import puck as task
import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import Compose, EnvBase, StepCounter, Transform, TransformedEnv

from pemirl_lab.measuring.own_proofs import (
    EPISODES,
    Proved,
    distances,
    of_contexts,
    result,
    told,
    train_on_true_reward,
    without_tasks,
    write_results,
)
from pemirl_trl import (
    AbsorbingState,
    ContextPolicy,
    DemonstrationDataset,
    PEMIRLModel,
    adapt,
    meta_train,
)
from pemirl_trl.evaluation import Actor, returns_per_task, whole_episodes
from pemirl_trl.modules.model import Policy

ROOT = Path(__file__).parents[2]
SHIFT = -1.0  # the pushes are reversed


def run(seed: int, training: dict[str, Any], optimization: dict[str, Any]) -> Proved:
    """Meta-train, infer and adapt; what it came to, in true returns per gate.

    Args:
        seed: of demonstrations and training.
        training, optimization: settings that differ from the defaults, for a quick look.
    """
    began = time.perf_counter()
    labelled = task.demonstrations(400, seed=10_000 + seed)
    pile = without_tasks(labelled)
    new = task.demonstrations(10, seed=20_000 + seed)
    model = meta_train(task.make, pile, seed=seed, **training)
    trained = time.perf_counter()
    adaptation = adapt(model, without_tasks(new), task.make_reversed, seed=seed, **optimization)
    seconds = {"meta_training": trained - began, "adaptation": time.perf_counter() - trained}
    inferred = of_contexts(model, new.with_absorbing_states(task.T))
    oracle = reinforcement_learning(model, new, seed, optimization)
    actors: dict[str, tuple[Actor, float]] = {
        "expert": (act, SHIFT),
        "random": (None, SHIFT),
        "carried_over": (model.policy, SHIFT),
        "adapted": (adaptation.policy, SHIFT),
        "rl_with_true_reward": (oracle, SHIFT),
        "one_shot": (model.policy, 1.0),
    }
    scores = {name: score(model, inferred, *acting) for name, acting in actors.items()}
    means = {name: sum(each["returns"]) / len(new) for name, each in scores.items()}
    found = result(
        *("puck", seed, means),
        scores=scores,
        demonstrated_lengths=pile.lengths.tolist(),
        **told(adaptation),
        distances=distances(model, new),
        seconds=seconds,
    )
    return Proved(found, model, pile, training)


def environment(n: int, seed: int, transform: Transform, push: float) -> EnvBase:
    """Whole episodes of what the transform writes at reset, which go on where they end."""
    base = task.Puck(n, seed, push)
    return TransformedEnv(base, Compose(AbsorbingState(), StepCounter(task.T), transform))


def act(td: TensorDictBase) -> TensorDictBase:
    """The controller that knows the gate, and that the pushes are reversed."""
    return td.set("action", task.controller(td["observation"], td["task", "gate"], SHIFT))


def score(
    model: PEMIRLModel, transform: Transform, actor: Actor, push: float
) -> dict[str, list[float]]:
    """Of the mean action, in the same episodes for all; one number a gate.

    Returns:
        True returns; learned ones; shares of episodes that leave the table; and where they end, in
        metres from the gate.
    """
    torch.manual_seed(0)
    env = environment(10 * EPISODES, 30_000, transform.clone(), push)
    rollouts = whole_episodes(env, actor, task.T)
    last, gate = rollouts["next", "observation"][:, -1], rollouts["task", "gate"][:, -1]
    with torch.no_grad():
        learned = model.reward.reward(rollouts["observation"], rollouts["context"])
    each = {
        "learned_returns": learned.sum((1, 2)),
        "leaves": last[:, -1],
        "end_to_gate": (last[:, :2] - gate).norm(dim=-1),
    }
    means = {name: values.view(-1, EPISODES).mean(1).tolist() for name, values in each.items()}
    return {"returns": returns_per_task(rollouts, EPISODES).tolist(), **means}


def reinforcement_learning(
    model: PEMIRLModel, new: DemonstrationDataset, seed: int, settings: dict[str, Any]
) -> Policy:
    """A policy that reads the gate, on the true reward, with adaptation's own settings.

    But for one: an exit is paid for by the step that leads to it, so that the true reward is no
    function of a step's start, and trajectories for other gates cannot be scored by it.
    """
    optimization = {**settings.get("optimization", {}), "imitate_best": 0.0}
    return train_on_true_reward(
        *(model, new),
        lambda scale, learned: ContextPolicy(
            *(model.observation_dim, 2, 2),
            activation=nn.Tanh,
            initial_scale=scale,
            learn_scale=learned,
            context_key=("task", "gate"),
        ),
        lambda n, at, resets: environment(n, at, resets, SHIFT),
        *(seed, {**settings, "optimization": optimization}),
    )


def main() -> None:
    """A result for each seed of the command line."""
    write_results(ROOT, lambda seed: [run(seed, {}, {})], sys.argv[1:])


if __name__ == "__main__":
    main()
