"""Copy a trained model to where it is shared, with its card.

    pemirl export_model model_file=runs/mine/model.safetensors to=mine.safetensors licence=MIT

The file holds q, r, h and the policy; ``pemirl_trl.load_model(FILE)`` reads it, and
``pemirl_trl.load_card(FILE)`` what its card says: domain, demonstrations, settings, measures.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import field

from pydantic.dataclasses import dataclass

from pemirl_lab.measuring.cards import Export, summary, write_page
from pemirl_lab.runs.own_task import parse_words
from pemirl_lab.runs.run_folder import say
from pemirl_trl.configuration import CHECKED
from pemirl_trl.files import expanded, read_metadata
from pemirl_trl.pretrained import load_model, save_model


@dataclass(frozen=True, config=CHECKED)
class Words(Export):
    """The values of this command.

    Attributes:
        to: where the model goes.
    """

    to: str = field(kw_only=True)


def main(arguments: Sequence[str]) -> None:
    """Entry point."""
    if {"-h", "--help"} & set(arguments):
        say(f"{__doc__}")
        return
    try:
        words = parse_words(arguments, Words)
        card, file = words.card(), expanded(words.to)
        model = load_model(words.model_file)
        kept = ("method", "env_steps")
        facts = {k: v for k, v in read_metadata(words.model_file).items() if k in kept}
        save_model(file, model, facts, card=card)
        page = write_page(card, file)
    except (FileNotFoundError, ValueError) as error:
        sys.exit(f"pemirl export_model: {error}")
    sizes = {"S": model.observation_dim, "A": model.action_dim, "T": model.horizon}
    say(summary(card, file, page, sizes))
