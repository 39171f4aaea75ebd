"""Environment steps per second: the raw engine, the environment, and a policy in the loop.

Runs interleaved repetitions of each contender in one process, so that a change in the machine's
load meets all of them, and reports medians and their ratios to the raw engine. The raw engine
replays the controls that the policy drew, from the same states, and computes the stage that the
task reads: contacts cost time, so other controls would be other work. Torch runs on one thread, as
in the recipes::

    python benchmarks/stepping.py --task sweeper/normal --num-envs 800 --output sweeper.json
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Callable

import mujoco
import numpy as np
import torch
import torchrl
from mujoco.batch import Batch
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import ExplorationType, set_exploration_type

from pemirl_envs import TaskEnv, get_task, make
from pemirl_envs.simulation.timers import timers_off
from pemirl_trl import ContextPolicy

Runs = dict[str, Callable[[], object]]
Controls = dict[str, np.ndarray]


def gaussian_actor(env: TaskEnv) -> ContextPolicy:
    """The policy of the methods, of the paper's size, conditioned on the task."""
    task = env.observation_spec["task"]
    (key,) = task.keys()
    observation_size = env.observation_spec["observation"].shape[-1]
    return ContextPolicy(
        observation_size,
        env.action_spec.shape[-1],
        task[key].shape[-1],
        context_key=("task", key),
    )


def recorded(env: TaskEnv, actor: ContextPolicy) -> tuple[Tensor, Tensor, list[Controls]]:
    """The states at a reset, and what the actor then did in an episode.

    Its clipped actions ``[T, N, A]``, and for each step the engine's fields that they set.
    """
    data, actions, controls = env.reset(), [], []
    start = env.physics_state()
    low, high = env.task.action_bounds
    for _ in range(env.task.horizon):
        data = actor(data)
        actions.append(data["action"].clamp(low, high))
        control = env.task.control(env.episodes.simulation.field, actions[-1])
        controls.append({name: value.double().numpy() for name, value in control.items()})
        data = env.step_and_maybe_reset(data)[1]
    return start, torch.stack(actions), controls


def contenders(name: str, num_envs: int, num_threads: int | None) -> Runs:
    """One episode of ``num_envs`` simulations in each way, by the name of the way."""
    task = get_task(name)
    env = make(name, num_envs, seed=0, num_threads=num_threads)
    actor = gaussian_actor(env)
    collected = make(name, num_envs, seed=0, num_threads=num_threads)
    collector = Collector(
        collected,
        gaussian_actor(collected),
        frames_per_batch=num_envs * task.horizon,
        total_frames=-1,
        device=collected.device,
        track_traj_ids=False,
        auto_register_policy_transforms=False,
    )
    batches = iter(collector)
    start, actions, controls = recorded(env, actor)
    batch = Batch(task.model, num_envs, env.episodes.simulation.num_threads)
    fields = {name: batch.bind(name) for name in controls[0]}

    def engine_as_shipped() -> None:
        batch.state[:] = start.numpy()
        for control in controls:
            for name, values in control.items():
                fields[name][:] = values
            batch.step(None, task.n_sub_steps, task.stage)

    def raw_engine() -> None:
        with timers_off():  # as the environment does: the faster yardstick
            engine_as_shipped()

    def environment() -> None:
        data = env.reset()
        for action in actions:
            data = env.step(data.set("action", action))["next"].exclude("reward")

    def hand_rollout() -> None:
        data, steps = env.reset(), []
        for _ in range(task.horizon):
            step, data = env.step_and_maybe_reset(actor(data))
            steps.append(step)
        torch.stack(steps, 1)

    return {
        "raw engine": raw_engine,
        "raw engine, with its timers": engine_as_shipped,
        "environment": environment,
        "environment + policy": hand_rollout,
        "collector": lambda: next(batches),
    }


def measure(runs: Runs, repetitions: int) -> dict[str, list[float]]:
    """Wall-clock seconds of each repetition of each run, interleaved, after one warm-up."""
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        for repetition in range(repetitions + 1):
            for name, run in runs.items():
                start = time.perf_counter()
                run()
                if repetition:
                    seconds[name].append(time.perf_counter() - start)
    return seconds


def report(arguments: argparse.Namespace, seconds: dict[str, list[float]]) -> dict[str, object]:
    """Median steps per second of each contender, and median of its ratio to the raw engine."""
    steps = arguments.num_envs * get_task(arguments.task).horizon
    raw = seconds["raw engine"]
    return {
        "task": arguments.task,
        "num_envs": arguments.num_envs,
        "num_threads": arguments.num_threads,
        "torch_threads": torch.get_num_threads(),
        "repetitions": arguments.repetitions,
        "steps_per_second": {
            name: round(steps / statistics.median(times)) for name, times in seconds.items()
        },
        "ratio_to_raw_engine": {
            name: round(statistics.median(r / t for r, t in zip(raw, times, strict=True)), 3)
            for name, times in seconds.items()
        },
        "cpus": os.cpu_count(),
        "machine": platform.platform(),
        "versions": {
            "python": platform.python_version(),
            "mujoco": mujoco.__version__,
            "numpy": np.__version__,
            "torch": torch.__version__,
            "torchrl": torchrl.__version__,
        },
    }


def write_json(path: pathlib.Path, content: dict[str, object]) -> None:
    """Writes a file that is complete or absent."""
    with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
        json.dump(content, file, indent=2)
    os.replace(file.name, path)


def main() -> None:
    """Measures, writes a table to standard output and, with ``--output``, a JSON file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="point_maze/left")
    parser.add_argument("--num-envs", type=int, default=800)
    parser.add_argument("--num-threads", type=int, help="default: one for each usable CPU")
    parser.add_argument("--repetitions", type=int, default=10)
    parser.add_argument("--output", type=pathlib.Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        runs = contenders(arguments.task, arguments.num_envs, arguments.num_threads)
    result = report(arguments, measure(runs, arguments.repetitions))
    ratios = result["ratio_to_raw_engine"]
    sys.stdout.write(f"{'':28}{'steps/s':>10}{'of raw':>9}\n")
    for name, rate in result["steps_per_second"].items():
        sys.stdout.write(f"{name:28}{rate:>10,}{ratios[name]:>9.0%}\n")
    if arguments.output:
        write_json(arguments.output, result)


if __name__ == "__main__":
    main()
