"""Meta-training on a task of one's own, in one call."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from pemirl_trl.configuration import present_device
from pemirl_trl.data import DemonstrationDataset, examine
from pemirl_trl.methods.consistency import doubts, measured, recovered_share, sharpness
from pemirl_trl.methods.defaults import found_for_meta_training, meta_training_config, table
from pemirl_trl.methods.early_ends import for_training
from pemirl_trl.methods.environments import Episodes, MakeEnv
from pemirl_trl.methods.meta_il import MetaIL
from pemirl_trl.methods.meta_training import MethodConfig, build, new_model, start_from
from pemirl_trl.methods.stages import OnIteration, RunStage, stages
from pemirl_trl.modules import PEMIRLModel, TrainingFamily
from pemirl_trl.transforms import InferContext

LOG = logging.getLogger("pemirl_trl")


def meta_train(
    make_env: MakeEnv,
    demonstrations: DemonstrationDataset | str | Path,
    preset: str = "robust",
    *,
    task_space: Sequence[int] | None = None,
    seed: int = 0,
    device: str = "cpu",
    on_iteration: OnIteration | None = None,
    checkpoint: str | Path | None = None,
    observation_keys: Sequence[str] | None = None,
    **overrides: Any,
) -> PEMIRLModel:
    """Learn q(m | demonstration), r(s, m) and a policy from unlabelled demonstrations.

    The settings that follow from the demonstrations are logged (logger ``pemirl_trl``, level
    ``INFO``); :func:`pemirl_trl.methods.meta_training_config` returns them beforehand. No true
    reward is read.

    Args:
        make_env: ``make_env(num_envs, seed)`` makes the environment of the demonstrations, with
            episodes as long as the longest of them, or that end by themselves (``terminated``)
            before; see :class:`pemirl_trl.AbsorbingState` and :data:`MakeEnv`. Its actions are
            vectors, or choices where every demonstrated action is one-hot.
        demonstrations: of many tasks, one or more of each; or the file of them.
        preset: ``"robust"``, whose rewards transfer where observations are what the task is about;
            ``"contrastive"``, where a body or an object stands in between (needs ``task_space``);
            ``"paper"``, the published method.
        task_space: which components of an observation the task is about, for ``"contrastive"``.
        seed: of everything random.
        device: of the learner, ``"cuda"`` where there is one; the environment stays where it is,
            and the model comes back to the CPU.
        on_iteration: called with the stage's name, the iteration (from 1) and its metrics.
        checkpoint: folder of checkpoints; the same call resumes a training that died.
        observation_keys: of an environment that observes several things: which of them make up the
            demonstrations' observations, in their order; ``"arm.angle"`` is nested.
        **overrides: fields of :class:`pemirl_trl.methods.MethodConfig`, nested ones as
            dictionaries: ``training={"iterations": 100}``.

    Raises:
        ValueError: an environment that cannot be trained on, before anything is trained; an unknown
            preset; a wrong setting; or a checkpoint of another training.
        TrainingDiverged: a quantity exploded.
    """
    data = as_dataset(demonstrations)
    config = meta_training_config(data, preset, overrides)
    found = table(found_for_meta_training(data, preset, overrides), config)
    LOG.info("meta-training with preset %s and\n%s", preset, found)
    for finding in examine(data):
        LOG.warning("%s", finding)
    what = f"{config} task_space={task_space} seed={seed} data={digest(data)}"
    run_stage = stages(on_iteration, checkpoint, hashlib.sha256(what.encode()).hexdigest())
    return meta_train_in_stages(
        *(make_env, data, config, run_stage),
        seed=seed,
        device=device,
        task_space=task_space,
        observation_keys=observation_keys,
    )


def meta_train_in_stages(
    make_env: MakeEnv,
    demonstrations: DemonstrationDataset,
    config: MethodConfig,
    run_stage: RunStage,
    *,
    seed: int,
    device: str = "cpu",
    task_space: Sequence[int] | None = None,
    observation_keys: Sequence[str] | None = None,
) -> PEMIRLModel:
    """What :func:`meta_train` does, with another way to run its two stages.

    Args:
        make_env, demonstrations, seed, device, task_space, observation_keys: as there.
        config: of the method.
        run_stage: runs ``"meta-il"`` and ``"meta-training"``.

    Raises:
        ValueError, TrainingDiverged: as there.
    """
    present_device(device)
    _check_family(demonstrations)
    _check_task_space(task_space, config, demonstrations.observation_dim)
    demonstrations, config = for_training(make_env, demonstrations, config, seed, observation_keys)
    torch.manual_seed(seed)
    meta_il = new_model(demonstrations, config, task_space=task_space)
    episodes = Episodes(make_env, meta_il, demonstrations, seed, observation_keys=observation_keys)
    pile = demonstrations.trajectories()
    run_stage("meta-il", MetaIL(meta_il.to(device), pile, config.meta_il))
    torch.manual_seed(seed)
    model = new_model(demonstrations, config, task_space=task_space)
    start_from(model.to(device), meta_il, config)
    rollouts = config.training.rollouts_per_context
    infer = InferContext(model.encoder, pile, rollouts_per_context=rollouts)
    env = episodes(config.contexts_per_batch * rollouts, seed, infer)
    run_stage("meta-training", build(config, model, env, pile))
    env.close(raise_if_closed=False)  # a collector may have closed it
    model.cpu()
    model.family = training_family(model, demonstrations)
    if model.config.context_dim > 0:
        recovered = recovered_share(model, demonstrations, episodes, seed)
        told = sharpness(model, demonstrations)._asdict()
        model.family = replace(model.family, recovered=recovered, **told)
        LOG.info("%s", measured(model.family))
        for doubt in doubts(model.family):
            LOG.warning("%s", doubt)
    return model


def _check_family(demonstrations: DemonstrationDataset) -> None:
    """Raise ValueError where nothing can tell tasks apart, before anything is trained."""
    if len(demonstrations) < 2:
        raise ValueError(
            f"got {len(demonstrations)} demonstration to meta-train on; expected those of many "
            "tasks, at least 2 and commonly hundreds. The one of a new task is for adapt (by "
            "command: adapt_reward)"
        )


def _check_task_space(task_space: object, config: MethodConfig, size: int) -> None:
    """Raise ValueError unless a task space is one, and somebody reads it."""
    if task_space is None:
        return  # new_model says who needs one
    if config.reward_reads != "task_space":
        raise ValueError(
            f"got task_space={task_space}, which r does not read here: it reads whole observations "
            f"(reward_reads={config.reward_reads}). Choose preset=contrastive or "
            "reward_reads=task_space, or leave task_space out"
        )
    chosen = list(task_space) if isinstance(task_space, Iterable) else [task_space]
    legal = all(type(part) is int and 0 <= part < size for part in chosen)
    if not (chosen and legal and len(set(chosen)) == len(chosen)):
        raise ValueError(
            f"task_space={task_space}: expected distinct numbers from 0 to {size - 1}, the "
            "components of an observation that the task is about"
        )


@torch.no_grad()
def training_family(model: PEMIRLModel, demonstrations: DemonstrationDataset) -> TrainingFamily:
    """Statistics of a model's training demonstrations, for ``model.family``."""
    contexts = model.encoder.get_dist(demonstrations.trajectories()).mean
    return TrainingFamily.fit(contexts, demonstrations.observation, model.standardize.scale)


def as_dataset(demonstrations: DemonstrationDataset | str | Path) -> DemonstrationDataset:
    """The data set itself, or that of a file.

    Raises:
        TypeError: neither was given.
        FileNotFoundError, ValueError: as :meth:`DemonstrationDataset.load`.
    """
    if isinstance(demonstrations, DemonstrationDataset):
        return demonstrations
    if isinstance(demonstrations, str | Path):
        return DemonstrationDataset.load(demonstrations)
    raise TypeError(
        f"got demonstrations of type {type(demonstrations).__name__}; expected a "
        "DemonstrationDataset (DemonstrationDataset.from_episodes makes one of pairs of arrays) or "
        "the name of its file"
    )


def check_model(model: object, *kinds: type) -> None:
    """Raise TypeError unless this is a model in memory, and not, say, the name of its file."""
    if isinstance(model, kinds):
        return
    cure = f": load_model({str(model)!r})" if isinstance(model, str | Path) else ""
    raise TypeError(
        f"got a model of type {type(model).__name__}; expected what pemirl_trl.load_model or "
        f"pemirl_trl.meta_train returns{cure}"
    )


def digest(demonstrations: DemonstrationDataset) -> str:
    """What tells demonstrations from others: a hash of their observations and actions."""
    content = hashlib.sha256()
    d = demonstrations
    for values in (d.observation, d.action, d.length, d.terminated):
        if values is None:
            continue
        content.update(values.detach().cpu().contiguous().numpy().tobytes())
    return content.hexdigest()
