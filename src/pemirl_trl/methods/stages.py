"""The stages of a long training, each resumable: who runs them decides what is shown and kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.methods.health_log import LOG, HealthLog
from pemirl_trl.methods.loop import Method, Metrics, train

CHECKPOINT_EVERY = 25
"""Iterations between checkpoints."""

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

    Signs of failure are logged when they begin and end (logger ``pemirl_trl.health``, level
    ``WARNING``), and all of them again when a stage is done (``INFO``).

    Args:
        on_iteration: called after each iteration.
        checkpoint: folder; the same call resumes from what is there. None keeps none.
        identity: what tells this training from another in the same folder, which is refused.
    """

    def run(stage: str, method: Method, /) -> None:
        folder = None if checkpoint is None else Path(checkpoint) / stage
        health = HealthLog(stage, None if folder is None else folder / "health.json")

        def report(iteration: int, metrics: Metrics) -> None:
            health(iteration, metrics)
            if iteration % CHECKPOINT_EVERY == 0 or iteration == method.iterations:
                health.save()
            if on_iteration is not None:
                on_iteration(stage, iteration, metrics)

        kept = None
        if folder is not None:
            kept = TrainingCheckpoint(folder, f"{stage} of {identity}")
        train(method, checkpoint=kept, checkpoint_every=CHECKPOINT_EVERY, on_iteration=report)
        if health.health.iteration:  # else there was nothing left to do
            LOG.info("%s: %s", stage, health.health.summary())

    return run
