"""The stages of a long training, each resumable: who runs them decides what is shown and kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.methods.loop import Method, Metrics, train

OnIteration = Callable[[str, int, Metrics], None]
"""(stage, iteration from 1, its metrics)."""


class RunStage(Protocol):
    """Runs a method to its end."""

    def __call__(self, stage: str, method: Method, /) -> object:
        """Run the stage of that name."""


def stages(
    on_iteration: OnIteration | None, checkpoint: str | Path | None, identity: str
) -> RunStage:
    """Run stages in this process, with a folder of checkpoints for each below ``checkpoint``.

    Args:
        on_iteration: called after each iteration.
        checkpoint: folder; the same call resumes from what is there. None keeps none.
        identity: what tells this training from another in the same folder, which is refused.
    """

    def run(stage: str, method: Method, /) -> None:
        report = None
        if on_iteration is not None:

            def report(iteration: int, metrics: Metrics) -> None:
                on_iteration(stage, iteration, metrics)

        kept = None
        if checkpoint is not None:
            kept = TrainingCheckpoint(Path(checkpoint) / stage, f"{stage} of {identity}")
        train(method, checkpoint=kept, on_iteration=report)

    return run
