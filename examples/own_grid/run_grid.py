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
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import Compose, EnvBase, StepCounter, Transform, TransformedEnv

from pemirl_lab.commands.adapt_reward import load_adapted
from pemirl_lab.results import environment_facts
from pemirl_trl import (
    CategoricalPolicy,
    DemonstrationDataset,
    InferContext,
    JoinObservations,
    OneHotActions,
    PEMIRLModel,
    SampleTasks,
    infer,
    load_model,
)
from pemirl_trl.evaluation import Actor, episode_returns
from pemirl_trl.files import atomic_path
from pemirl_trl.methods import PolicyOptimization, adaptation_config, train

HERE = Path(__file__).parent
RESULTS = HERE.parents[1] / "results" / "own_tasks" / "grid"
EPISODES = 10  # of each unseen goal, for the report
GOALS = 10
GOAL = ("task", "goal")
TURNED = -1  # every move does the opposite


def run(seed: int, folder: Path, settings: Sequence[str] = (), adapting: Any = None) -> Any:
    """Meta-train, infer and adapt; what it came to, in true returns per goal.

    Args:
        seed: of demonstrations and training.
        folder: for the files of the run.
        settings: words of ``pemirl meta_train`` beside the defaults, for a quick look.
        adapting: settings of the adaptation that differ from the defaults, nested.
    """
    new = task.demonstrations(GOALS, seed=20_000 + seed)
    unlabelled = {"pile": task.demonstrations(400, seed=10_000 + seed), "new": new}
    for name, data in unlabelled.items():
        without_tasks(data).save(folder / f"{name}.safetensors")
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
    policy, _ = load_adapted(folder / "adapt" / "policy.safetensors", model)
    inferred = InferContext(
        model.encoder,
        new,
        rollouts_per_context=EPISODES,
        draw="all",
        sample=False,
        tasks=new.tasks(),
    )
    goals = SampleTasks(lambda count: new.tasks()[:count], rollouts_per_task=EPISODES)
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
    worst, best = means["carried_over"], means["rl_with_true_reward"]
    told = json.loads((folder / "adapt" / "adaptation.json").read_text("utf-8"))
    one_each = without_tasks(new)
    return {
        "task": "own_tasks/grid",
        "seed": seed,
        "gap_closed": (means["adapted"] - worst) / (best - worst),
        "means": means,
        "per_goal": returns,
        **{name: told[name] for name in ("kept", "start", "tries", "learned_return", "warnings")},
        "carried_over_learned_return": told["carried_over_return"],
        "distances": [str(infer(model, one_each[i]).distance) for i in range(GOALS)],
        "reward_at_goal": share_at_goal(model, new),
        "adaptation_env_steps": told["env_steps"],
        "settings": {"meta_train": [*settings], "adapt_reward": words(adapting or {})},
        "seconds": {"meta_training": trained, "adaptation": adapted},
        **environment_facts(),
    }


def command(*arguments: str) -> float:
    """Run a command of the library where grid.py is; the seconds that it took."""
    logging.info("pemirl %s", shlex.join(arguments))
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "pemirl_lab.cli", *arguments], cwd=HERE, check=True)
    return time.perf_counter() - began


def words(settings: dict[str, Any], prefix: str = "") -> list[str]:
    """Nested settings as words of a command."""
    found: list[str] = []
    for name, value in settings.items():
        nested = isinstance(value, dict)
        found += words(value, f"{prefix}{name}.") if nested else [f"{prefix}{name}={value}"]
    return found


def without_tasks(demonstrations: DemonstrationDataset) -> DemonstrationDataset:
    """What a learner is given: observations and actions."""
    return DemonstrationDataset(demonstrations.observation, demonstrations.action)


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
) -> CategoricalPolicy:
    """A policy that reads the goal, on the true reward, with adaptation's own settings."""
    torch.manual_seed(seed)
    config = adaptation_config(model, new, settings)
    rollouts = config.rollouts // len(new)
    goals = SampleTasks(lambda count: new.tasks()[:count], rollouts_per_task=rollouts)
    policy = CategoricalPolicy(
        *(2, len(task.MOVES), 2),
        activation=nn.Tanh,
        initial_scale=config.policy_scale,
        context_key=GOAL,
    )

    def reward(observation: Tensor, goal: Tensor) -> Tensor:
        return task.true_reward(observation, goal)

    method = PolicyOptimization(
        environment(len(new) * rollouts, seed, goals, TURNED),
        policy,
        task.T,
        config.optimization,
        rollouts_per_context=rollouts,
        reward=TensorDictModule(reward, ["observation", GOAL], ["learned_reward"]),
        task_keys=(GOAL,),
    )
    train(method)
    return policy


def main() -> None:
    """A result for each seed of the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)
    for seed in map(int, sys.argv[1:] or ["0"]):
        with tempfile.TemporaryDirectory() as folder:
            result = run(seed, Path(folder))
        RESULTS.mkdir(parents=True, exist_ok=True)
        with atomic_path(RESULTS / f"seed{seed}.json") as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        logging.info("seed %d: gap closed %.3f; %s", seed, result["gap_closed"], result["means"])


if __name__ == "__main__":
    main()
