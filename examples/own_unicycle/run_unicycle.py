"""One demonstration in, its reward out: the unicycle of unicycle.py, with the library's defaults.

``python examples/own_unicycle/run_unicycle.py 0 1 2`` writes
``results/own_tasks/unicycle/seed<n>.json`` for each seed, two minutes each: both motors are
reversed. True returns are for this report; no learner reads them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import unicycle
from tensordict import TensorDictBase

from pemirl_lab.measuring.own_proofs import write_results
from pemirl_lab.measuring.state_proofs import StateTask, prove

RESULTS = Path(__file__).parents[2] / "results" / "own_tasks" / "unicycle"


def expert(td: TensorDictBase) -> TensorDictBase:
    """The controller that knows the place, and that the motors are reversed."""
    return td.set("action", unicycle.controller(td["observation"], td["task", "target"], -1.0))


REVERSED = StateTask(
    "unicycle",
    unicycle.T,
    unicycle.make,
    unicycle.make_reversed,
    unicycle.demonstrations,
    expert,
    unicycle.true_reward,
)


def main() -> None:
    """A result for each seed of the command line."""
    write_results(RESULTS, lambda seed: prove(REVERSED, seed), sys.argv[1:])


if __name__ == "__main__":
    main()
