"""Environment steps per second of meta-training, with the raw engine's in the same run.

One iteration of Algorithm 1 collects whole episodes and does all its updates: encoder and reward,
then the policy. Its rate is divided by that of MuJoCo's own batch with as many simulations and
threads, under the controls that the policy drew in its last iteration: contacts cost time, so other
controls would be other work. Repetitions are interleaved, so that a change in the machine's load
meets all contenders, and medians count, the ratio's over pairs of neighbours::

    python benchmarks/training.py --num-threads 2 --output training.json
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import mujoco
import torch
import torchrl
from mujoco.batch import Batch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from pemirl_envs import get_task, make, task_parameters
from pemirl_envs.simulation.mujoco_batch import available_cpus
from pemirl_envs.simulation.timers import timers_off
from pemirl_trl import InferContext, PEMIRLModel, Standardize
from pemirl_trl.methods import PEMIRL, PEMIRLConfig

CONTEXTS = 50  # per iteration, as in the paper
ROLLOUTS = (8, 16)  # per context: this project's default, and the authors' code's

Seconds = dict[str, float]
Contender = Callable[[], Seconds]


class TimedPEMIRL(PEMIRL):
    """PEMIRL that keeps the seconds of its parts, and the actions of its last iteration."""

    seconds: Seconds
    actions: Tensor  # [N, T, A]
    _updated: tuple[float, float]  # when encoder and reward began and finished

    def iteration(self) -> dict[str, float]:
        """One iteration; ``seconds`` holds the parts of the last one."""
        start = time.perf_counter()
        metrics = super().iteration()
        end = time.perf_counter()
        began, finished = self._updated
        self.seconds = {
            "encoder and reward": finished - began,
            "policy": end - finished,
            "collection": began - start,
        }
        return metrics

    def _update_encoder_and_reward(self, rollouts: TensorDictBase) -> dict[str, float]:
        self.actions = rollouts["action"]
        began = time.perf_counter()
        metrics = super()._update_encoder_and_reward(rollouts)
        self._updated = began, time.perf_counter()
        return metrics


def raw_engine(method: TimedPEMIRL, name: str, num_threads: int) -> Contender:
    """One episode of MuJoCo's batch under the controls of the method's last iteration."""
    task = get_task(name)
    num_envs = method.actions.shape[0]
    batch = Batch(task.model, num_envs, num_threads)
    low, high = task.action_bounds

    def run() -> Seconds:
        controls = method.actions.clamp(low, high).transpose(0, 1).double().contiguous().numpy()
        start = time.perf_counter()
        with timers_off():  # as the environment does
            batch.reset()
            for control in controls:
                batch.ctrl[:] = control
                batch.step(nstep=task.n_sub_steps)
        return {"whole": time.perf_counter() - start}

    return run


def random_demonstrations(name: str, count: int) -> TensorDictBase:
    """Rollouts of random actions: the work of an iteration does not depend on who acts."""
    env = make(name, count, seed=0)
    keys = ("observation", "action", ("next", "observation"))
    rollouts = env.rollout(env.task.horizon).select(*keys)
    rollouts.batch_size = [count]
    return rollouts


def meta_training(name: str, rollouts: int, num_threads: int) -> TimedPEMIRL:
    """PEMIRL after its first iteration."""
    tasks = task_parameters(name, "train_100")
    experts = random_demonstrations(name, len(tasks))
    observation, action = experts["observation"], experts["action"]
    model = PEMIRLModel(
        observation.shape[-1],
        action.shape[-1],
        action.shape[1],
        standardize=Standardize.fit(observation),
    )
    env = make(name, CONTEXTS * rollouts, seed=0, num_threads=num_threads)
    context = InferContext(model.encoder, experts, rollouts_per_context=rollouts, tasks=tasks)
    config = PEMIRLConfig(rollouts_per_context=rollouts)
    method = TimedPEMIRL(model, TransformedEnv(env, context), experts, config)

    method.iteration()
    return method


def iteration(method: TimedPEMIRL) -> Contender:
    """One iteration, with all updates."""

    def run() -> Seconds:
        method.iteration()
        return {"whole": sum(method.seconds.values()), **method.seconds}

    return run


def measure(contenders: dict[str, Contender], repetitions: int) -> dict[str, list[Seconds]]:
    """The seconds of each contender's interleaved repetitions, after one warm-up."""
    seconds: dict[str, list[Seconds]] = {name: [] for name in contenders}
    for repetition in range(repetitions + 1):
        for name, run in contenders.items():
            spent = run()
            if repetition:
                seconds[name].append(spent)
    return seconds


def report(arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure, and relate each meta-training to the raw engine with as many simulations."""
    name, threads = arguments.task, arguments.num_threads
    horizon = get_task(name).horizon
    contenders: dict[str, Contender] = {}
    for k in ROLLOUTS:
        method = meta_training(name, k, threads)
        contenders[f"meta-training, {CONTEXTS} x {k}"] = iteration(method)
        contenders[f"raw engine, {CONTEXTS * k}"] = raw_engine(method, name, threads)
    measured = measure(contenders, arguments.repetitions)
    rows: dict[str, dict[str, Any]] = {}
    for k in ROLLOUTS:
        steps = CONTEXTS * k * horizon
        engine = [spent["whole"] for spent in measured[f"raw engine, {CONTEXTS * k}"]]
        training = measured[f"meta-training, {CONTEXTS} x {k}"]
        whole = [spent["whole"] for spent in training]
        pairs = zip(engine, whole, strict=True)
        rows[f"raw engine, {CONTEXTS * k}"] = {"steps_per_second": round(steps / median(engine))}
        rows[f"meta-training, {CONTEXTS} x {k}"] = {
            "steps_per_second": round(steps / median(whole)),
            "ratio_to_raw_engine": round(median(e / w for e, w in pairs), 3),
            "share_of_time": {
                part: round(median(s[part] / s["whole"] for s in training), 3)
                for part in training[0]
                if part != "whole"
            },
        }
    return {
        "task": name,
        "num_threads": threads,
        "torch_threads": torch.get_num_threads(),
        "repetitions": arguments.repetitions,
        "results": rows,
        "cpus": os.cpu_count(),
        "machine": platform.platform(),
        "versions": {
            "python": platform.python_version(),
            "mujoco": mujoco.__version__,
            "torch": torch.__version__,
            "torchrl": torchrl.__version__,
        },
    }


def table(rows: dict[str, dict[str, Any]]) -> str:
    """The rows, for people."""
    lines = [f"{'':24}{'steps/s':>10}{'of raw':>8}  time goes to"]
    for name, row in rows.items():
        ratio = f"{row['ratio_to_raw_engine']:.0%}" if "ratio_to_raw_engine" in row else ""
        parts = sorted(row.get("share_of_time", {}).items(), key=lambda item: -item[1])
        split = ", ".join(f"{part} {share:.0%}" for part, share in parts)
        lines.append(f"{name:24}{row['steps_per_second']:>10,}{ratio:>8}  {split}".rstrip())
    return "\n".join(lines) + "\n"


def write_json(path: pathlib.Path, content: dict[str, Any]) -> None:
    """Write a file that is complete or absent."""
    with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
        json.dump(content, file, indent=2)
    os.replace(file.name, path)


def main() -> None:
    """Print a table and, with ``--output``, write a JSON file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="point_maze/left")
    parser.add_argument(
        "--num-threads", type=int, default=available_cpus(), help="of the simulations"
    )
    parser.add_argument("--repetitions", type=int, default=9)
    parser.add_argument("--output", type=pathlib.Path, help="a JSON file")
    arguments = parser.parse_args()
    # The tensors are small, and on a busy machine OpenMP's threads spin: ten times slower.
    torch.set_num_threads(1)
    result = report(arguments)
    sys.stdout.write(table(result["results"]))
    if arguments.output:
        write_json(arguments.output, result)


if __name__ == "__main__":
    main()
