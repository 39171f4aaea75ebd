"""From unlabelled demonstrations to a policy on a reward inferred from one demonstration.

    pemirl quickstart
    pemirl quickstart experiment=ant seed=1
    pemirl quickstart preset=smoke            # seconds: does everything run here?
    pemirl quickstart -m seed=0,1,2           # three seeds, one after the other

Meta-trains on Point-Maze with the barrier on the left, infers the goals of 30 unseen tasks from one
demonstration each, trains a policy on the inferred rewards with the barrier on the right, and
prints a table. Give the same command again after an interruption: it resumes.
"""

from __future__ import annotations

import time

from pydantic.dataclasses import dataclass

from pemirl_lab.commands.adapt_reward import adapt
from pemirl_lab.commands.evaluate import Own as Evaluation
from pemirl_lab.commands.evaluate import evaluate
from pemirl_lab.commands.meta_train import meta_train
from pemirl_lab.pages.run_page import write_run_page
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl.configuration import CHECKED


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own: where results go, and the table they belong to."""

    results: str
    table_name: str


def run(settings: Settings, own: Own) -> None:
    """Meta-train, adapt, evaluate."""
    start = time.perf_counter()
    folder = RunFolder.of(settings)
    model = meta_train(settings, folder)
    adapt(settings, folder, model)
    evaluation = Evaluation(
        results=own.results,
        table_name=own.table_name,
        meta_run=settings.run_dir,
        adaptation_run=settings.run_dir,
    )
    evaluate(settings, evaluation, folder)
    write_run_page(folder.path)
    say(f"all of it took {(time.perf_counter() - start) / 60:.1f} minutes")
