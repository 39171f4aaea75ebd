"""Demonstrations of several lengths, made to fit a method and a model."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.methods.environments import MakeEnv, ends_early
from pemirl_trl.methods.meta_training import MethodConfig
from pemirl_trl.modules import ContextEncoder, PEMIRLModel
from pemirl_trl.sharing import PortableReward

LOG = logging.getLogger("pemirl_trl")


def for_training(
    make_env: MakeEnv,
    demonstrations: DemonstrationDataset,
    config: MethodConfig,
    seed: int,
    observation_keys: Sequence[str] | None = None,
) -> tuple[DemonstrationDataset, MethodConfig]:
    """What a method is trained on: with absorbing states, if episodes end by themselves.

    They do if a demonstration did, if the environment does with random actions, or if the
    configuration says so (``model.absorbing``).
    """
    absorbing = config.model.absorbing
    if not absorbing and ends_early(make_env, demonstrations.horizon, seed, observation_keys):
        LOG.info("episodes end early: they go on in absorbing states (model.absorbing)")
        absorbing = True
    if not absorbing:
        return demonstrations, config
    config = dataclasses.replace(config, model=dataclasses.replace(config.model, absorbing=True))
    return demonstrations.with_absorbing_states(), config


def for_model(
    model: PEMIRLModel | PortableReward, demonstrations: DemonstrationDataset
) -> DemonstrationDataset:
    """New demonstrations as a model reads them: up to its horizon, with absorbing states or not.

    Raises:
        ValueError: one is longer than the model's horizon.
    """
    if demonstrations.horizon > model.horizon:
        lengths = demonstrations.lengths
        raise ValueError(
            f"{int((lengths > model.horizon).sum())} of the demonstrations have up to "
            f"{int(lengths.max())} steps; this model was trained on episodes of at most "
            f"{model.horizon}: cut them, or meta-train on longer ones"
        )
    if model.config.absorbing:
        return demonstrations.with_absorbing_states(model.horizon)
    if isinstance(model.encoder, ContextEncoder):
        return demonstrations  # of its own length, or refused with the sizes of both
    return demonstrations.padded(model.horizon)
