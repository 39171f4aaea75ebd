"""From unlabelled demonstrations to a policy on a reward inferred from one demonstration.

    python recipes/quickstart.py
    python recipes/quickstart.py seed=1 method=pemirl
    python recipes/quickstart.py preset=smoke            # seconds: does everything run here?
    python recipes/quickstart.py -m seed=0,1,2           # three seeds, one after the other

Meta-trains on Point-Maze with the barrier on the left, infers the goals of 30 unseen tasks from one
demonstration each, trains a policy on the inferred rewards with the barrier on the right, and
prints a table. Give the same command again after an interruption: it resumes.
"""

from __future__ import annotations

import time

import hydra
from adapt_reward import adapt
from evaluate import evaluate
from meta_train import meta_train
from omegaconf import DictConfig
from run_folder import RunFolder, say


def quickstart(config: DictConfig) -> None:
    """Meta-train, adapt, evaluate."""
    start = time.perf_counter()
    folder = RunFolder(config)
    model = meta_train(config, folder)
    adapt(config, folder, model)
    evaluate(config, folder, folder.path, folder.path)
    say(f"all of it took {(time.perf_counter() - start) / 60:.1f} minutes")


@hydra.main(config_path="conf", config_name="quickstart", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    quickstart(config)


if __name__ == "__main__":
    main()
