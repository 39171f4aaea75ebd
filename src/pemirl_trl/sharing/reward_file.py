"""One file that holds a reward: networks, the map of observations, its card."""

from __future__ import annotations

import json
from pathlib import Path

from pemirl_trl.files import Card, load_weights, parse_json, read_weights, save_weights
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.pretrained import (
    compare,
    load_card,
    load_model,
    model_file,
    parse_sizes,
    stated,
)
from pemirl_trl.sharing.portable import PortableReward


def save_reward(
    model: PEMIRLModel | PortableReward, path: str | Path, *, card: Card | None = None
) -> None:
    """Write r, h, q and the map of observations to one safetensors file, atomically.

    Args:
        model: a trained one, or a reward that was read.
        path: the file.
        card: where it is from; None keeps a reward's own.

    Raises:
        ValueError: a model without r(s, m).
        OSError: it cannot be written; the message names the file and says what to do.
    """
    reward = model if isinstance(model, PortableReward) else PortableReward.of(model)
    facts = {"pemirl_reward": json.dumps(reward.sizes)}
    # Names as in a model's file, so that the same check of sizes serves both.
    save_weights(path, {"model": reward}, facts | stated(reward.family, card or reward.card))


def load_reward(path: str | Path) -> PortableReward:
    """Read a reward; ``load_reward(FILE)(observation, m)`` is r(s, m). Nothing is unpickled.

    Args:
        path: of :func:`save_reward`; or the file of a whole model, or its name in the zoo, of
            which the reward is taken.

    Raises:
        FileNotFoundError: there is no such file, and no model of this name.
        ValueError: the file holds something else, is damaged, or contradicts itself; or the model
            has no r(s, m).
    """
    path = model_file(path)
    tensors, metadata = read_weights(path)
    if "pemirl_model" in metadata:
        return PortableReward.of(load_model(path), load_card(path) if "card" in metadata else None)
    if "pemirl_reward" not in metadata:
        raise ValueError(f"{path} holds weights {sorted(metadata)}, expected those of a reward")
    sizes = parse_sizes(metadata["pemirl_reward"], f"the sizes of the reward in {path}")
    compare(sizes, tensors, path, without="policy")
    extra = {
        argument: parse_json(metadata[entry], f"the {entry} in {path}")
        for argument, entry in (("family", "training_family"), ("card", "card"))
        if entry in metadata
    }
    reward = PortableReward(sizes, **extra)
    load_weights(path, {"model": reward})
    return reward
