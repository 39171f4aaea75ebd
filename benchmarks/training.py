"""Environment steps per second of meta-training and of adaptation, beside the raw engine's.

An iteration collects whole episodes and does all its updates: encoder and reward, then the policy,
in meta-training (Algorithm 1); the policy alone in adaptation (Algorithm 2). Its rate is divided by
that of MuJoCo's own batch with as many simulations and threads, under the controls that the policy
drew in its last iteration: contacts cost time, so other controls would be other work. Repetitions
are interleaved, so that a change in the machine's load meets all contenders, and medians count, the
ratio's over pairs of neighbours. CPU time is that of all threads. The peak memory is that of a
process of its own, which does two iterations. Where the learner has several threads, they should
sleep while they wait, as the commands tell them (``OMP_WAIT_POLICY=passive``)::

    python benchmarks/training.py --task ant/normal --num-threads 2 --output training_ant.json
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
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from statistics import median
from typing import Any

import mujoco
import numpy as np
import torch
import torchrl
from mujoco.batch import Batch
from torch import Tensor
from trainings import SETTINGS, TRAINED, Seconds, Setting, Timed, peak_memory

from pemirl_envs import TaskEnv, get_task, make
from pemirl_envs.simulation.mujoco_batch import available_cpus
from pemirl_envs.simulation.timers import timers_off

Contender = Callable[[], Seconds]
Controls = dict[str, np.ndarray]


def recorded(env: TaskEnv, actions: Tensor) -> tuple[np.ndarray, list[Controls]]:
    """The states at a reset, and for each step the engine's fields that the actions then set."""
    data, controls = env.reset(), []
    start = env.physics_state().numpy()
    low, high = env.task.action_bounds
    for action in actions.transpose(0, 1):
        control = env.task.control(env.episodes.simulation.field, action.clamp(low, high))
        controls.append({name: value.double().numpy().copy() for name, value in control.items()})
        data = env.step(data.set("action", action))["next"].exclude("reward")
    return start, controls


def raw_engine(method: Timed, name: str, num_threads: int) -> Contender:
    """One episode of MuJoCo's batch under the controls of the method's last iteration."""
    env = make(name, method.actions.shape[0], seed=0, num_threads=num_threads)
    batch = Batch(env.task.model, method.actions.shape[0], num_threads)

    def run() -> Seconds:
        states, controls = recorded(env, method.actions)
        fields = {name: batch.bind(name) for name in controls[0]}
        start, cpu = time.perf_counter(), time.process_time()
        with timers_off():  # as the environment does
            batch.state[:] = states
            for control in controls:
                for name, values in control.items():
                    fields[name][:] = values
                batch.step(None, env.task.n_sub_steps, env.task.stage)
        return {"whole": time.perf_counter() - start, "cpu": time.process_time() - cpu}

    return run


def iteration(method: Timed, torch_threads: int) -> Contender:
    """One iteration, with all updates."""

    def run() -> Seconds:
        torch.set_num_threads(torch_threads)
        cpu = time.process_time()
        method.iteration()
        spent = {"whole": sum(method.seconds.values()), **method.seconds}
        return spent | {"cpu": time.process_time() - cpu}

    return run


def peak_memory_alone(setting: Setting, *given: Any) -> int:
    """:func:`peak_memory` of a process of its own, in MiB."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(peak_memory, setting, *given).result()


def measure(contenders: dict[str, Contender], repetitions: int) -> dict[str, list[Seconds]]:
    """The seconds of each contender's interleaved repetitions, after one warm-up."""
    seconds: dict[str, list[Seconds]] = {name: [] for name in contenders}
    for repetition in range(repetitions + 1):
        for name, run in contenders.items():
            spent = run()
            if repetition:
                seconds[name].append(spent)
    return seconds


def training_row(steps: int, training: list[Seconds], engine: list[Seconds]) -> dict[str, Any]:
    """Medians over the repetitions of so many environment steps each."""
    whole = median(spent["whole"] for spent in training)
    ratios = {
        part: round(median(e[part] / t[part] for e, t in zip(engine, training, strict=True)), 3)
        for part in ("whole", "cpu")
    }
    return {
        "steps_per_second": round(steps / whole),
        "ratio_to_raw_engine": ratios["whole"],
        "ratio_of_cpu_time": ratios["cpu"],
        "seconds_per_iteration": round(whole, 3),
        "cpu_us_per_step": _cpu(steps, training),
        "share_of_time": {
            part: round(median(spent[part] / spent["whole"] for spent in training), 3)
            for part in training[0]
            if part not in ("whole", "cpu")
        },
    }


def _cpu(steps: int, spent: list[Seconds]) -> float:
    """Microseconds of CPU time per environment step."""
    return round(median(each["cpu"] for each in spent) / steps * 1e6, 2)


def report(arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure, and relate each training to the raw engine with as many simulations."""
    name, threads = arguments.task, arguments.num_threads
    given = (name, arguments.method)
    # First, while this process is small: what a parent needs at most counts for its children too.
    memory = {setting: peak_memory_alone(setting, *given, threads) for setting in SETTINGS}
    contenders: dict[str, Contender] = {}
    for setting in SETTINGS:
        method = setting.start(*given, threads)
        contenders[setting.title] = iteration(method, setting.torch_threads)
        contenders[setting.engine] = raw_engine(method, name, threads)
    measured = measure(contenders, arguments.repetitions)
    rows: dict[str, dict[str, Any]] = {}
    for setting in SETTINGS:
        steps = setting.simulations * get_task(name).horizon
        engine, training = measured[setting.engine], measured[setting.title]
        rows[setting.engine] = {
            "steps_per_second": round(steps / median(spent["whole"] for spent in engine)),
            "cpu_us_per_step": _cpu(steps, engine),
        }
        rows[setting.title] = training_row(steps, training, engine)
        rows[setting.title]["peak_memory_mib"] = memory[setting]
    return {
        "task": name,
        "method": arguments.method,
        "num_threads": threads,
        "repetitions": arguments.repetitions,
        "results": rows,
        **machine(),
    }


def machine() -> dict[str, Any]:
    """Where it ran: hardware, how busy it is, and versions."""
    return {
        "cpus": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
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
    heading = f"{'':40}{'steps/s':>10}{'of raw':>8}{'of CPU':>8}{'s':>8}{'MiB':>7}"
    lines = [f"{heading}  time goes to"]
    for name, row in rows.items():
        names = ("ratio_to_raw_engine", "ratio_of_cpu_time")
        ratio = "".join(f"{row[n]:>8.0%}" if n in row else " " * 8 for n in names)
        parts = sorted(row.get("share_of_time", {}).items(), key=lambda item: -item[1])
        split = ", ".join(f"{part} {share:.0%}" for part, share in parts)
        seconds, memory = row.get("seconds_per_iteration", ""), row.get("peak_memory_mib", "")
        figures = f"{row['steps_per_second']:>10,}{ratio}{seconds:>8}{memory:>7}"
        lines.append(f"{name:40}{figures}  {split}".rstrip())
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
    parser.add_argument("--method", default="pemirl", choices=TRAINED, help="of meta-training")
    parser.add_argument(
        "--num-threads", type=int, default=available_cpus(), help="of the simulations"
    )
    parser.add_argument("--repetitions", type=int, default=9)
    parser.add_argument("--output", type=pathlib.Path, help="a JSON file")
    arguments = parser.parse_args()
    result = report(arguments)
    sys.stdout.write(table(result["results"]))
    if arguments.output:
        write_json(arguments.output, result)


if __name__ == "__main__":
    main()
