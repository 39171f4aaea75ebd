"""Put a trained reward into a file of its own, with its card.

    pemirl export_reward model_file=runs/mine/model.safetensors reward_file=mine.safetensors

The file holds r, h, q and the map of observations, without the policy;
``pemirl_trl.load_reward(FILE)(observation, m)`` is r. ``licence=MIT`` says what others may do with
it. With ``folder=NAME`` in the place of ``reward_file`` it is a folder as model hubs have it. A
model that is in no run's folder has no card: ``pemirl_trl.save_reward`` writes such a one.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from pydantic.dataclasses import dataclass

from pemirl_lab.measuring.cards import Export, summary, write_page
from pemirl_lab.runs.own_task import parse_words
from pemirl_lab.runs.run_folder import say
from pemirl_trl.configuration import CHECKED
from pemirl_trl.files import expanded
from pemirl_trl.pretrained import load_model
from pemirl_trl.sharing import PortableReward, save_reward


@dataclass(frozen=True, config=CHECKED)
class Words(Export):
    """The values of this command.

    Attributes:
        reward_file: where the reward goes; or
        folder: where it goes as a folder.
    """

    reward_file: str | None = None
    folder: str | None = None


def main(arguments: Sequence[str]) -> None:
    """Entry point."""
    if {"-h", "--help"} & set(arguments):
        say(f"{__doc__}")
        return
    try:
        words = parse_words(arguments, Words)
        if (words.reward_file is None) == (words.folder is None):
            raise ValueError("expected one of reward_file=FILE and folder=NAME")
        card = words.card()
        reward = PortableReward.of(load_model(words.model_file), card)
        if words.reward_file is not None:
            file = expanded(words.reward_file)
            save_reward(reward, file)
            page = write_page(card, file)
        else:
            file = expanded(words.folder or "")
            reward.save_pretrained(file)
            page = file / "README.md"
    except (FileNotFoundError, ValueError) as error:
        sys.exit(f"pemirl export_reward: {error}")
    sizes = {"S": reward.observation_dim, "D": reward.config.context_dim}
    say(summary(card, file, page, sizes))
