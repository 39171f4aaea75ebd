"""Look at demonstrations before anything is learned from them.

    pemirl check my_demonstrations.safetensors
    pemirl check my_demonstrations.safetensors --environment point_maze/left
    pemirl check lerobot_folder --observation-keys state,environment_state
    pemirl check d4rl.hdf5
    pemirl check minari:pendulum-v0

First their lengths; then one line for each thing that is suspicious, with its cure: constant
features, duplicates, actions far outside their bounds, jumps, resets inside an episode, mixed
sampling, too few demonstrations, short ones of which nobody says why.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import pemirl_envs
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.run_folder import say
from pemirl_trl import DemonstrationDataset
from pemirl_trl.data import examine


def main(arguments: Sequence[str]) -> None:
    """Entry point; the exit code is 1 where a finding is an error."""
    parser = argparse.ArgumentParser("pemirl check", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("file", help="of DemonstrationDataset.save, .npz, .hdf5, a folder of "
                        "LeRobot's or imitation's, or minari:NAME")  # fmt: skip
    parser.add_argument("--observation-keys", help="entries that make the observation: a,b")
    parser.add_argument("--discrete-actions", type=int, help="n, where actions are integers")
    parser.add_argument("--environment", help="whose bounds actions are compared with")
    given = parser.parse_args(arguments)
    try:
        keys = None if given.observation_keys is None else given.observation_keys.split(",")
        demonstrations = DemonstrationDataset.load(
            data_file(given.file), observation_keys=keys, discrete_actions=given.discrete_actions
        )
        bounds = None
        if given.environment is not None:
            bounds = pemirl_envs.get_task(given.environment).action_bounds
            wanted, got = len(bounds[0]), demonstrations.action_dim
            if got not in (0, wanted):
                parser.exit(2, f"pemirl check: {given.file} has {got} actions, and "
                            f"{given.environment} takes {wanted}\n")  # fmt: skip
        findings = examine(demonstrations, bounds)
    except (FileNotFoundError, ImportError, ValueError) as error:
        parser.exit(2, f"pemirl check: {error}\n")
    d = demonstrations
    say(
        f"{given.file}: {len(d)} demonstrations of {_lengths(d)}, {d.observation_dim} "
        f"observed numbers, {d.action_dim or 'no'} actions; made by: {d.provenance.command}"
    )
    for finding in findings:
        say(str(finding))
    if not findings:
        say("nothing suspicious")
    if any(finding.severity == "error" for finding in findings):
        sys.exit(1)


def _lengths(demonstrations: DemonstrationDataset) -> str:
    """How many steps they have, and how the shorter ones came to their end."""
    d, lengths = demonstrations, demonstrations.lengths
    if d.length is None:
        return f"{d.horizon} steps"
    low, high, middle = int(lengths.min()), int(lengths.max()), float(lengths.float().median())
    return (
        f"{low} to {high} steps (median {middle:g}; {int(d.ended.sum())} ended by themselves "
        f"before T = {d.horizon}, {int(d.cut.sum())} were cut)"
    )
