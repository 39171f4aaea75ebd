"""A run that is killed at any moment, again and again, ends as one that was left alone.

The moments are drawn from a seed, in real time: where a kill falls differs from machine to machine,
and what the run ends with must not.
"""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from safetensors.torch import load_file

CODE = "from pemirl_lab.cli import main; main()"
# A slow disk, as far as a process can tell: what makes writing safe takes its time, so that kills
# fall between the steps of it.
SLOW = """
import os, time
def slowly(call):
    def slow(*arguments, **options):
        time.sleep(0.02)
        result = call(*arguments, **options)
        time.sleep(0.02)
        return result
    return slow
for name in ("fsync", "replace", "rename", "unlink", "mkdir", "rmdir"):
    setattr(os, name, slowly(getattr(os, name)))
"""
ALONE = os.environ | {"MUJOCO_GL": "disable", "CUDA_VISIBLE_DEVICES": "", "PYTHONHASHSEED": "0"}
SMALL = (
    "preset=smoke", "threads=1", "seed=3", "training.iterations=12",
    "adaptation.optimization.iterations=8", "checkpoint_every=2", "meta_il.steps=60",
)  # fmt: skip
COMMANDS = {
    "quickstart": ("run_dir=run",),
    "meta_train": ("method=pemirl", "run_dir=run"),
    "train_expert": (
        "output=expert.safetensors", "run_dir=run", "expert_training.optimization.iterations=8",
        "expert_training.tasks_per_batch=4", "expert_training.rollouts_per_task=2",
    ),
}  # fmt: skip
KILLS = 17  # of each command, on each disk


def begin(command, cwd, code=CODE):
    words = [sys.executable, "-c", code, command, *SMALL, *COMMANDS[command]]
    with (cwd.parent / f"{cwd.name}.log").open("ab") as log:
        return subprocess.Popen(words, cwd=cwd, env=ALONE, stdout=log, stderr=log)


def ended_well(process, cwd):
    assert process.wait() == 0, (cwd.parent / f"{cwd.name}.log").read_text()[-2000:]


def weights(folder: Path):
    """Every weight and curve that a command left, by file."""
    tensors = {
        str(file.relative_to(folder)): {k: v.numpy().tobytes() for k, v in load_file(file).items()}
        for file in sorted(folder.rglob("*.safetensors"))
        if "checkpoints" not in file.parts
    }
    curves = {file.name: file.read_bytes() for file in sorted(folder.rglob("curves/*.json"))}
    rows = {
        str(file.relative_to(folder)): [
            line.split(",")[0] for line in file.read_text().splitlines()
        ]
        for file in sorted(folder.rglob("scalars/**/*.csv"))
    }
    return tensors, curves, rows


def killed_often(command, folder, whole, draw, code, most):
    """Begin a run again and again, killing it up to ``most`` times; how often it was."""
    folder.mkdir()
    for kills in range(most):
        process = begin(command, folder, code)
        try:
            process.wait(timeout=draw.uniform(0.4, 0.95) * whole)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
        else:
            ended_well(process, folder)
            return kills
    ended_well(begin(command, folder, code), folder)
    return most


@pytest.mark.long
@pytest.mark.parametrize("disk", ["", SLOW], ids=["disk", "slow disk"])
@pytest.mark.parametrize("command", COMMANDS)
def test_no_kill_changes_a_result(command, disk, tmp_path):
    alone = tmp_path / "alone"
    alone.mkdir()
    ended_well(begin(command, alone), alone)
    start = time.perf_counter()
    ended_well(begin(command, alone, disk + CODE), alone)  # nothing is left: what starting takes
    starting = time.perf_counter() - start
    draw, kills, runs = random.Random(command), 0, 0
    whole = 2 * starting
    while kills < KILLS:
        folder = tmp_path / f"killed{runs}"
        kills += killed_often(command, folder, whole, draw, disk + CODE, KILLS - kills)
        runs += 1
        assert weights(folder) == weights(alone)
    where = " on a slow disk" if disk else ""
    print(f"{command}{where}: {kills} kills, {runs} runs, all as the one that was left alone")
