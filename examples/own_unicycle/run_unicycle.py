"""One demonstration in, its reward out: the unicycle of unicycle.py, with the library's defaults.

``python examples/own_unicycle/run_unicycle.py 0 1 2`` writes
``results/own_tasks/unicycle/seed<n>.json`` for each seed, two minutes each: both motors are
reversed. ``run_unicycle.py whole 0 1 2`` is for comparison (``unicycle_whole``): Meta-IL reads
demonstrations whole alone, at a rate that does not fall. True returns are for this report; no
learner reads them.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import unicycle
from tensordict import TensorDictBase

from pemirl_lab.measuring.own_proofs import write_results
from pemirl_lab.measuring.state_proofs import StateTask, prove

ROOT = Path(__file__).parents[2]


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


WHOLE = {"meta_il": {"part_share": 0.0, "lr": 1e-3, "lr_schedule": "constant"}}
"""Meta-IL as the published method has it."""


def main() -> None:
    """A result for each seed of the command line."""
    words = [word for word in sys.argv[1:] if word != "whole"]
    whole = len(words) < len(sys.argv[1:])
    task = replace(REVERSED, name="unicycle_whole") if whole else REVERSED
    write_results(ROOT, lambda seed: prove([task], seed, WHOLE if whole else {}), words)


if __name__ == "__main__":
    main()
