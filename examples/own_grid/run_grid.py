"""One demonstration in, its reward out, with discrete actions: the grid of grid.py, by commands.

``python examples/own_grid/run_grid.py 0 1 2`` writes ``results/own_tasks/grid/seed<n>.json`` for
each seed, some minutes each; the commands are printed as they are run. True returns are for this
report; no learner reads them.
"""

from __future__ import annotations

import json
import logging
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import grid as task
import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import Compose, EnvBase, StepCounter, Transform, TransformedEnv

from pemirl_lab.measuring.own_proofs import (
    EPISODES,
    Proved,
    distances,
    of_contexts,
    of_tasks,
    result,
    train_on_true_reward,
    without_tasks,
    words,
    write_results,
)
from pemirl_trl import (
    CategoricalPolicy,
    DemonstrationDataset,
    JoinObservations,
    OneHotActions,
    PEMIRLModel,
    infer,
    load_model,
    load_policy,
)
from pemirl_trl.evaluation import Actor, episode_returns
from pemirl_trl.modules.model import Policy

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
GOALS = 10
GOAL = ("task", "goal")
TURNED = -1  # every move does the opposite


def run(seed: int, folder: Path, settings: Sequence[str] = (), adapting: Any = None) -> Proved:
    """Meta-train, infer and adapt; what it came to, in true returns per goal.

    Args:
        seed: of demonstrations and training.
        folder: for the files of the run.
        settings: words of ``pemirl meta_train`` beside the defaults, for a quick look.
        adapting: settings of the adaptation that differ from the defaults, nested.
    """
    new = task.demonstrations(GOALS, seed=20_000 + seed)
    pile = without_tasks(task.demonstrations(400, seed=10_000 + seed))
    pile.save(folder / "pile.safetensors")
    without_tasks(new).save(folder / "new.safetensors")
    common = [f"observation_keys=[{','.join(task.KEYS)}]", f"seed={seed}"]
    model_file = folder / "meta_train" / "model.safetensors"
    trained = command(
        *("meta_train", f"demonstrations={folder}/pile.safetensors", "env=grid:make"),
        *(f"run_dir={folder}/meta_train", *common, *settings),
    )
    adapted = command(
        *("adapt_reward", f"model_file={model_file}", "env=grid:make_turned"),
        *(f"test_demonstrations={folder}/new.safetensors", f"run_dir={folder}/adapt"),
        *(*common, *words(adapting or {})),
    )
    model = load_model(model_file)
    policy = load_policy(folder / "adapt" / "policy.safetensors", model)
    inferred, goals = of_contexts(model, new), of_tasks(new)
    returns = {
        "expert": score(goals, expert),
        "random": score(goals, None),
        "carried_over": score(inferred, model.policy),
        "adapted": score(inferred, policy),
        "rl_with_true_reward": score(
            goals, reinforcement_learning(model, new, seed, adapting or {})
        ),
        "one_shot": score(inferred, model.policy, keys=1),
    }
    means = {name: sum(each) / len(each) for name, each in returns.items()}
    said = json.loads((folder / "adapt" / "adaptation.json").read_text("utf-8"))
    found = result(
        *("grid", seed, means),
        per_goal=returns,
        **{
            name: said[name]
            for name in ("kept", "start", "exploration", "tries", "learned_return", "warnings")
        },
        carried_over_learned_return=said["carried_over_return"],
        distances=distances(model, new),
        reward_at_goal=share_at_goal(model, new),
        adaptation_env_steps=said["env_steps"],
        settings={"meta_train": [*settings], "adapt_reward": words(adapting or {})},
        seconds={"meta_training": trained, "adaptation": adapted},
    )
    return Proved(found, model, pile, {"words": [*settings]} if settings else {})


def command(*arguments: str) -> float:
    """Run a command of the library where grid.py is; the seconds that it took."""
    logging.info("pemirl %s", shlex.join(arguments))
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "pemirl_lab.cli", *arguments], cwd=HERE, check=True)
    return time.perf_counter() - began


def environment(n: int, seed: int, transform: Transform, keys: int) -> EnvBase:
    """Whole episodes of what the transform writes at reset."""
    base = task.Grid(n, seed, keys)
    one_hot = OneHotActions.of(base)
    parts = [JoinObservations(task.KEYS, base), one_hot, StepCounter(task.T), transform]
    return TransformedEnv(base, Compose(*parts))


def expert(td: TensorDictBase) -> TensorDictBase:
    """The controller that knows the goal, and that the moves are turned around."""
    move = task.controller(td["observation"], td["task", "goal"], TURNED)
    return td.set("action", nn.functional.one_hot(move, len(task.MOVES)).float())


def score(transform: Transform, actor: Actor, keys: int = TURNED) -> list[float]:
    """True returns, one a goal: the likeliest action, in the same episodes for all."""
    torch.manual_seed(0)
    env = environment(GOALS * EPISODES, 30_000, transform.clone(), keys)
    return episode_returns(env, actor, task.T, episodes_per_task=EPISODES).tolist()


def share_at_goal(model: PEMIRLModel, new: DemonstrationDataset) -> float:
    """Share of the new goals within one cell of where the inferred reward is highest."""
    cells = torch.cartesian_prod(torch.arange(task.SIZE), torch.arange(task.SIZE))
    found = 0
    for i in range(len(new)):
        reward = infer(model, without_tasks(new)[i]).reward(task.observation(cells))
        off = cells[int(reward.argmax())] - new.tasks()["goal"][i]
        found += int(off.abs().max() <= 1)
    return found / len(new)


def reinforcement_learning(
    model: PEMIRLModel, new: DemonstrationDataset, seed: int, settings: dict[str, Any]
) -> Policy:
    """A policy that reads the goal, on the true reward, with adaptation's own settings."""
    return train_on_true_reward(
        *(model, new),
        lambda share, _: CategoricalPolicy(
            *(2, len(task.MOVES), 2), activation=nn.Tanh, initial_scale=share, context_key=GOAL
        ),
        lambda n, at, resets: environment(n, at, resets, TURNED),
        *(seed, settings),
        reward=task.true_reward,
        reads=("observation", GOAL),
    )


def in_a_folder(seed: int) -> list[Proved]:
    """A run whose files are not kept."""
    with tempfile.TemporaryDirectory() as folder:
        return [run(seed, Path(folder))]


def main() -> None:
    """A result for each seed of the command line."""
    write_results(ROOT, in_a_folder, sys.argv[1:])


if __name__ == "__main__":
    main()
