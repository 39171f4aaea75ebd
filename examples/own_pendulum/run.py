"""One demonstration in, its reward out: the pendulum of pendulum.py, with the library's defaults.

``python examples/own_pendulum/run.py 0 1 2`` writes ``results/own_tasks/pendulum/seed<n>.json`` for
each seed, some minutes each: the motor is reversed. ``run.py light 0 1 2`` is for a quarter of the
mass (``pendulum_light``). True returns are for this report; no learner reads them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pendulum
from tensordict import TensorDictBase

from pemirl_lab.measuring.own_proofs import write_results
from pemirl_lab.measuring.state_proofs import StateTask, prove
from pemirl_trl.evaluation import Actor
from pemirl_trl.methods import MakeEnv

RESULTS = Path(__file__).parents[2] / "results" / "own_tasks"


def expert(motor: float, mass: float) -> Actor:
    """The controller that knows the target, and what has changed."""

    def act(td: TensorDictBase) -> TensorDictBase:
        state, target = td["observation"], td["task", "target"]
        return td.set("action", pendulum.controller(state, target, motor, mass))

    return act


def changed(name: str, make: MakeEnv, motor: float = 1.0, mass: float = pendulum.MASS) -> StateTask:
    """The pendulum, and what is different where the policy is to act."""
    return StateTask(
        name,
        pendulum.T,
        pendulum.make,
        make,
        pendulum.demonstrations,
        expert(motor, mass),
        pendulum.true_reward,
    )


REVERSED = changed("pendulum", pendulum.make_reversed, motor=-1.0)
LIGHT = changed("pendulum_light", pendulum.make_light, mass=pendulum.LIGHT)


def main() -> None:
    """A result for each seed of the command line."""
    light = "light" in sys.argv[1:]
    task = LIGHT if light else REVERSED
    seeds = sys.argv[2 if light else 1 :]
    write_results(RESULTS / task.name, lambda seed: prove(task, seed), seeds)


if __name__ == "__main__":
    main()
