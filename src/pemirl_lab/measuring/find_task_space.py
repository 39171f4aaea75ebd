"""What a reward may read where the dynamics change, from demonstrations by two or more bodies.

    pemirl find_task_space demonstrations=[healthy.safetensors,lame.safetensors]
    pemirl find_task_space demonstrations=[a.safetensors,b.safetensors] meta_il.steps=1500

A file for each body. Where they say which task each demonstration is of, equal ones are paired;
otherwise demonstration i of every file is of the same task, whichever that is. Prints what each
component of an observation, and all of them together, tell of the task in a body that was left
out, in nats a step, and the
``task_space`` for ``pemirl meta_train preset=contrastive``. Settings of Meta-IL can be given.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any

import torch
from pydantic.dataclasses import dataclass
from torch import Tensor
from tqdm import tqdm

from pemirl_lab.runs.own_task import parse_words
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.run_folder import say
from pemirl_trl import DemonstrationDataset, TaskSpace, find_task_space
from pemirl_trl.configuration import CHECKED, SeedNumber
from pemirl_trl.methods.loop import Metrics

_SHOWN = 10  # components, from the best


@dataclass(frozen=True, config=CHECKED)
class Words:
    """The values of this command.

    Attributes:
        demonstrations: a file for each body.
        seed: of networks and draws.
        settings: of Meta-IL and its networks.
    """

    demonstrations: Sequence[str]
    seed: SeedNumber = 0
    settings: Mapping[str, Any] = field(default_factory=dict)


def main(arguments: Sequence[str]) -> None:
    """Entry point."""
    if {"-h", "--help"} & set(arguments):
        say(str(__doc__))
        return
    torch.set_num_threads(1)
    try:
        words = parse_words(arguments, Words, rest=True)
        bodies = [DemonstrationDataset.load(data_file(name)) for name in words.demonstrations]
        with tqdm(desc="meta-il", unit="it", file=sys.stderr) as bar:

            def show(stage: str, iteration: int, metrics: Metrics) -> None:
                bar.set_postfix_str(f"loss {metrics['meta_il/loss_imitation']:.3f}")
                bar.update()

            found = find_task_space(
                bodies,
                tasks_of(bodies),
                settings=words.settings,
                seed=words.seed,
                on_iteration=show,
            )
    except (FileNotFoundError, ValueError) as error:
        sys.exit(f"pemirl find_task_space: {error}")
    say(table(found))


def tasks_of(bodies: Sequence[DemonstrationDataset]) -> list[Tensor] | None:
    """Numbers of each body's demonstrations, equal for equal tasks; None: they do not say."""
    if any(data.task is None for data in bodies):
        return None
    rows = [
        torch.cat([value.flatten(1) for _, value in sorted(data.tasks().items())], -1)
        for data in bodies
    ]
    if len({row.shape[-1] for row in rows}) > 1:
        return None
    _, numbers = torch.cat(rows).unique(dim=0, return_inverse=True)
    return list(numbers.split([len(row) for row in rows]))


def table(found: TaskSpace) -> str:
    """The best components by their worst body, and what to do with them."""
    order = found.worst.argsort(descending=True)[:_SHOWN].tolist()
    lines = ["component   nats in the worst body   in each body"]
    for i in order:
        each = "  ".join(f"{value:7.3f}" for value in found.nats[:, i].tolist())
        lines.append(f"{i:>9}   {float(found.worst[i]):22.3f}   {each}")
    each = "  ".join(f"{value:7.3f}" for value in found.whole.tolist())
    lines.append(f"{'all':>9}   {float(found.whole.min()):22.3f}   {each}")
    if found.components:
        chosen = ",".join(map(str, found.components))
        lines.append(f"what tells the task in every body: task_space=[{chosen}]")
    else:
        lines.append(
            "no component tells the task in every body: more demonstrations, or other bodies; what "
            "only several components together tell is not found"
        )
    if found.whole.min() > max(0.0, float(found.worst.max())):
        lines.append(
            "all of them together tell more, in every body: r may read the whole state, as it does "
            "without task_space (preset=robust)"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main(sys.argv[1:])
