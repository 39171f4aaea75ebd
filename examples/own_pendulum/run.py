"""One demonstration in, its reward out: the pendulum of pendulum.py, with the library's defaults.

``python examples/own_pendulum/run.py 0 1 2`` writes, for each seed,
``results/own_tasks/pendulum/seed<n>.json``, where the motor is reversed, and ``pendulum_light``
beside it, with a quarter of the mass: some minutes each. True returns are for this report; no
learner reads them.
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

ROOT = Path(__file__).parents[2]


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
    """Two results for each seed of the command line."""
    write_results(ROOT, lambda seed: prove([REVERSED, LIGHT], seed), sys.argv[1:])


if __name__ == "__main__":
    main()
