"""The pendulum's model, with its card: ``python examples/own_pendulum/zoo.py FILE``."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import torch
from run import REVERSED

from pemirl_lab.measuring.state_proofs import measure
from pemirl_trl import Card, meta_train, save_model
from pemirl_trl.files import atomic_path
from pemirl_trl.methods.own_training import digest

SEED = 0


def main() -> None:
    """Train with the library's defaults, measure as run.py does, and write the two files."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)
    file = Path(sys.argv[1])
    demonstrations = REVERSED.pile(SEED)
    model = meta_train(REVERSED.make, demonstrations, seed=SEED)
    result = measure(REVERSED, model, SEED)
    card = Card(
        domain="examples/own_pendulum",
        data_sha256=digest(demonstrations),
        settings={"preset": "robust", "seed": SEED},
        measures={**result["means"], "gap_closed": result["gap_closed"]},
        licence="MIT",
        command="nox -s zoo -- pendulum",
        versions={**result["versions"], "commit": result["commit"]},
    )
    save_model(file, model, {"method": "pemirl_robust"}, card=card)
    with atomic_path(file.with_suffix(".md")) as temporary:
        temporary.write_text(card.markdown(file.stem), encoding="utf-8")


if __name__ == "__main__":
    main()
