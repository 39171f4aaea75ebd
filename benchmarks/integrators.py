"""What an ant's integrator costs and changes: AIRL's RK4 beside the default, Euler.

The error of each setting is that of one control step (0.05 s), against RK4 with a tenth of the time
step, from states that random actions lead to. Beside it stand the random policy's return, and the
contact cost of the original reward, which this package leaves out::

    python benchmarks/integrators.py --output integrators.json
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
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from pemirl_envs import get_task
from pemirl_envs.tasks.ant import Ant

SECONDS = Ant.n_sub_steps * 0.01  # of a control step
SETTINGS = {  # name: integrator, physics steps in a control step
    "RK4, 10 ms": ("RK4", 5),
    "Euler, 5 ms": ("EULER", 10),
    "Euler, 10 ms": ("EULER", 5),
    "implicitfast, 10 ms": ("IMPLICITFAST", 5),
}
REFERENCE = ("RK4", 50)
CONTACT_COST = 0.5e-3  # AIRL's, for forces clipped to 1 N


def compiled(task: Ant, integrator: str, n_sub_steps: int, *, sensor: bool = False) -> Any:
    """The task's model with other physics; an accelerometer makes MuJoCo compute ``cfrc_ext``."""
    spec = task.build_spec()
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    spec.option.timestep = SECONDS / n_sub_steps
    if sensor:
        spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        site = spec.body("torso").add_site(name="torso")
        spec.add_sensor(
            type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site.name,
        )
    return spec.compile()


def initial(task: Ant, n: int, seed: int) -> dict[str, Tensor]:
    """Initial states of ``n`` episodes."""
    generator = torch.Generator().manual_seed(seed)
    return dict(task.initial_state(task.sample_parameters(n, "train", generator), generator))


def started(model: Any, start: dict[str, Tensor]) -> Batch:
    """A batch on one thread in given states."""
    batch = Batch(model, len(start["qpos"]), 1)
    batch.reset()
    for name, values in start.items():
        batch.bind(name)[:] = values.numpy()
    return batch


def random_actions(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Actions of an untrained Gaussian policy, N(0, 1), clipped to [-1, 1]."""
    return np.random.default_rng(seed).standard_normal(shape).clip(-1, 1)


def errors(task: Ant, states: int) -> dict[str, dict[str, float]]:
    """Root-mean-square errors of one control step of each setting."""
    warm_up = started(compiled(task, *REFERENCE), initial(task, states, seed=0))
    controls = random_actions((41, states, 8), seed=1)
    for control in controls[:-1]:
        warm_up.ctrl[:] = control
        warm_up.step(nstep=REFERENCE[1])
    reached = {
        "qpos": torch.tensor(warm_up.bind("qpos")),
        "qvel": torch.tensor(warm_up.bind("qvel")),
    }
    ends = {}
    for name, setting in {"reference": REFERENCE, **SETTINGS}.items():
        batch = started(compiled(task, *setting), reached)
        batch.ctrl[:] = controls[-1]
        batch.step(nstep=setting[1])
        ends[name] = (batch.bind("qpos").copy(), batch.bind("qvel").copy())
    qpos, qvel = ends.pop("reference")
    return {
        name: {
            "rms_qpos": rms(position - qpos),
            "rms_qvel": rms(velocity - qvel),
            "rms_torso_vx": rms((velocity - qvel)[:, 0]),
        }
        for name, (position, velocity) in ends.items()
    }


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.square(values).mean()))


def play(task: Ant, setting: tuple[str, int], episodes: int, sensor: bool) -> dict[str, float]:
    """Episodes of random actions on the raw engine, half of them in either direction."""
    batch = started(compiled(task, *setting, sensor=sensor), initial(task, episodes, seed=2))
    fields = {name: torch.from_numpy(batch.bind(name)) for name in ("qpos", "qvel")}
    forces = batch.bind("cfrc_ext") if sensor else np.zeros((episodes, 14, 6))
    tasks = {"direction": torch.ones(episodes, 1)}
    tasks["direction"][::2] = -1
    returns, contact, seconds = torch.zeros(episodes), 0.0, 0.0
    for action in random_actions((task.horizon, episodes, 8), seed=3):
        returns += task.reward(fields.__getitem__, torch.from_numpy(action), tasks)
        batch.ctrl[:] = action
        before = time.process_time()
        batch.step(nstep=setting[1])
        seconds += time.process_time() - before
        contact += CONTACT_COST * float(np.square(forces.clip(-1, 1)).sum((1, 2)).mean())
    deviation = float(returns.std())
    return {
        "steps_per_cpu_second": episodes * task.horizon / seconds,
        "random_return": float(returns.mean()),
        "random_return_std": deviation,
        "random_return_standard_error": deviation / episodes**0.5,
        "contact_cost_per_1000_steps": 1000 * contact / task.horizon,
    }


def measure(task: Ant, states: int, episodes: int, repetitions: int) -> dict[str, dict[str, float]]:
    """Error, rate and consequences of every setting; medians of interleaved repetitions' rates."""
    runs = {name: (setting, False) for name, setting in SETTINGS.items()}
    runs["Euler, 10 ms, contact forces"] = (SETTINGS["Euler, 10 ms"], True)
    results = {name: dict(values) for name, values in errors(task, states).items()}
    rates: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repetitions):
        for name, (setting, sensor) in runs.items():
            played = play(task, setting, episodes, sensor)
            rates[name].append(played["steps_per_cpu_second"])
            results[name] = results.get(name, {}) | played
            if not sensor:  # without one MuJoCo reports no force
                results[name].pop("contact_cost_per_1000_steps")
    for name, measured in rates.items():
        results[name]["steps_per_cpu_second"] = statistics.median(measured)
    return {
        name: {key: float(f"{x:.4g}") for key, x in row.items()} for name, row in results.items()
    }


def write_json(path: pathlib.Path, content: dict[str, object]) -> None:
    """Writes a file that is complete or absent."""
    with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
        json.dump(content, file, indent=2)
    os.replace(file.name, path)


def main() -> None:
    """Measures, writes the results to standard output and, with ``--output``, to a JSON file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="ant/normal")
    parser.add_argument("--states", type=int, default=192)
    parser.add_argument("--episodes", type=int, default=128)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--output", type=pathlib.Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    task = get_task(arguments.task)
    if not isinstance(task, Ant):
        raise ValueError(f"expected an ant, got the task {arguments.task!r}")
    results = measure(task, arguments.states, arguments.episodes, arguments.repetitions)
    for name, row in results.items():
        values = "  ".join(f"{key} {value:g}" for key, value in row.items())
        sys.stdout.write(f"{name}: {values}\n")
    if arguments.output:
        settings = {key: value for key, value in vars(arguments).items() if key != "output"}
        versions = {"mujoco": mujoco.__version__, "python": platform.python_version()}
        write_json(arguments.output, {**settings, "results": results, "versions": versions})


if __name__ == "__main__":
    main()
