"""What one demonstration asks for: its context, its distance from the training family, its reward.

    pemirl infer model_file=runs/my_run/model.safetensors demonstration=one.safetensors
    pemirl infer model_file=point_maze demonstration=data/point_maze_test.safetensors index=0

Prints m with its posterior deviation, how far the demonstration is from those of training, and
r(s, m) along the demonstration.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from pydantic.dataclasses import dataclass
from torch import Tensor

from pemirl_lab.runs.own_task import parse_words
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.run_folder import say
from pemirl_trl import DemonstrationDataset, infer
from pemirl_trl.configuration import CHECKED, Count, Index
from pemirl_trl.sharing import load_reward

_SHOWN = 11  # steps of the demonstration, from the first to the last


@dataclass(frozen=True, config=CHECKED)
class Words:
    """The values of this command.

    Attributes:
        model_file: of ``pemirl meta_train`` or ``pemirl export_reward``, or a name of the zoo.
        demonstration: a file of demonstrations, or a folder in a format of others.
        index: which of them, where there are several.
        observation_keys: which entries make the observation, where the format has several.
        discrete_actions: n, where actions are integers from 0 to n - 1.
    """

    model_file: str
    demonstration: str
    index: Index | None = None
    observation_keys: Sequence[str] | None = None
    discrete_actions: Count | None = None


def main(arguments: Sequence[str]) -> None:
    """Entry point."""
    if {"-h", "--help"} & set(arguments):
        say(f"{__doc__}\nOf a file of several demonstrations, index=3 takes one.")
        return
    try:
        words = parse_words(arguments, Words)
        reward = load_reward(words.model_file)
        demonstrations = DemonstrationDataset.load(
            data_file(words.demonstration),
            observation_keys=words.observation_keys,
            discrete_actions=words.discrete_actions,
        )
        one = _chosen(demonstrations, words)
        inference = infer(reward, one)
    except (FileNotFoundError, ImportError, ValueError) as error:
        sys.exit(f"pemirl infer: {error}")
    say(str(inference))
    steps = one.observation[0, : int(one.lengths[0])]
    say(_along(inference.reward(steps).squeeze(-1)))


def _chosen(demonstrations: DemonstrationDataset, words: Words) -> DemonstrationDataset:
    count = len(demonstrations)
    if words.index is None:
        if count > 1:
            raise ValueError(
                f"{words.demonstration} holds {count} demonstrations: choose one with index=0 to "
                f"index={count - 1}"
            )
        return demonstrations
    if words.index >= count:
        raise ValueError(
            f"index={words.index}: expected 0 to {count - 1}, the demonstrations there"
        )
    return demonstrations[words.index]


def _along(reward: Tensor) -> str:
    """R along a demonstration ``[T]``, as lines."""
    last = len(reward) - 1
    steps = sorted({round(i * last / (_SHOWN - 1)) for i in range(_SHOWN)})
    lines = [f"  step {t:>5}  {float(reward[t]):>10.3f}" for t in steps]
    total = f"r(s, m) along the demonstration, in all {float(reward.sum()):.2f} (no unit):"
    return "\n".join([total, *lines])
