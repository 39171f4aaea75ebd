"""The one place that knows methods by their names: from configuration to a method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from config import typed
from domains import environment
from omegaconf import DictConfig
from public_code import PublicCodeInfoLoss

from pemirl_trl import DemonstrationDataset, InferContext, PEMIRLModel
from pemirl_trl.methods import (
    AIRL,
    PEMIRL,
    AIRLConfig,
    AveragedReward,
    MetaInfoGAIL,
    MetaInfoGAILConfig,
    PEMIRLConfig,
)
from pemirl_trl.methods.loop import Method

Builder = Callable[..., Method]


def build(config: DictConfig, model: PEMIRLModel, demonstrations: DemonstrationDataset) -> Method:
    """The method that ``config.algorithm`` names, on its environment.

    Meta-IL needs no environment: it comes before the others (``meta_train.py``).

    Raises:
        ValueError: there is no such algorithm; names the legal ones.
    """
    builders: dict[str, Builder] = {"pemirl": _pemirl, "airl": _airl, "meta_infogail": _gail}
    if config.algorithm not in builders:
        raise ValueError(
            f"unknown algorithm {config.algorithm!r}; choose one of {sorted(builders)}"
        )
    rollouts = config.training.rollouts_per_context
    transform = InferContext(
        model.encoder,
        demonstrations.trajectories(),
        rollouts_per_context=rollouts,
        # The environment is reset to the demonstrated task, so that its reward is a metric.
        tasks=None if demonstrations.task is None else demonstrations.tasks(),
    )
    env = environment(
        config.environment,
        config.contexts_per_batch * rollouts,
        transform,
        seed=config.seed,
        threads=config.threads,
    )
    method = builders[config.algorithm](config, model, env, demonstrations.trajectories())
    if config.reward_average_decay is None:
        return method
    return AveragedReward(method, model, config.reward_average_decay)


def _pemirl(config: DictConfig, model: PEMIRLModel, env: Any, trajectories: Any) -> Method:
    settings = typed(PEMIRLConfig, config.training)
    if config.info_estimator not in ("lemma2", "public_code"):
        raise ValueError(
            f"unknown info_estimator {config.info_estimator!r}; choose lemma2 or public_code"
        )
    public_code = config.info_estimator == "public_code"
    other = PublicCodeInfoLoss(model, trajectories, settings) if public_code else None
    return PEMIRL(model, env, trajectories, settings, info_loss=other)


def _airl(config: DictConfig, model: PEMIRLModel, env: Any, trajectories: Any) -> Method:
    return AIRL(model, env, trajectories, typed(AIRLConfig, config.training))


def _gail(config: DictConfig, model: PEMIRLModel, env: Any, trajectories: Any) -> Method:
    return MetaInfoGAIL(model, env, trajectories, typed(MetaInfoGAILConfig, config.training))
