"""Meta-train q(m | demonstration), r(s, m) and a policy on unlabelled demonstrations.

    pemirl meta_train
    pemirl meta_train experiment=ant
    pemirl meta_train method=airl seed=1
    pemirl meta_train training.info_coeff=0 model.context_dim=5 run_dir=runs/no_info

Writes ``model.safetensors`` and, where the method has contexts, ``meta_il.safetensors`` (Meta-IL:
a baseline, and what initialises the encoder) to ``run_dir``.
"""

from __future__ import annotations

import torch
from pydantic.dataclasses import dataclass

import pemirl_envs
from pemirl_lab.measuring.rollouts import environment
from pemirl_lab.public_code import PublicCodeInfoLoss
from pemirl_lab.runs.places import RunRefused, data_file
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset, InferContext, PEMIRLModel
from pemirl_trl.configuration import CHECKED
from pemirl_trl.data import examine
from pemirl_trl.methods import (
    MetaIL,
    MetaILConfig,
    MethodConfig,
    PEMIRLConfig,
    build,
    new_model,
    start_from,
)
from pemirl_trl.methods.loop import Method
from pemirl_trl.pretrained import save_model


@dataclass(frozen=True, config=CHECKED)
class Own:
    """This command has nothing of its own."""


def run(settings: Settings, own: Own) -> PEMIRLModel:
    """Meta-train in the folder that the settings name."""
    return meta_train(settings, RunFolder.of(settings))


def load_demonstrations(file: str, folder: RunFolder) -> DemonstrationDataset:
    """The unlabelled pile; what is suspicious about it is said, once a run."""
    demonstrations = DemonstrationDataset.load(folder.reads("demonstrations", data_file(file)))
    for finding in examine(demonstrations):
        say(f"{file}: {finding}")
    return demonstrations


def meta_train(
    settings: Settings, folder: RunFolder, meta_il: PEMIRLModel | None = None
) -> PEMIRLModel:
    """Meta-IL, where the method has contexts and it is not given; then the method."""
    learning = settings.learning
    demonstrations = load_demonstrations(settings.demonstrations, folder)
    check_sizes(settings, demonstrations)
    if meta_il is None and learning.model.context_dim > 0:
        meta_il = train_meta_il(settings.seed, learning, demonstrations, folder)
    if learning.algorithm == "meta_il" and meta_il is not None:
        return meta_il
    torch.manual_seed(settings.seed)
    model = new_model(demonstrations, learning, task_space=task_space(settings))
    start_from(model, meta_il, learning)
    method = build_method(settings, model, demonstrations)
    folder.train(settings.method, method, show="return/true")
    facts = {"method": settings.method, "env_steps": str(method.env_steps)}
    file = folder.file("model.safetensors")
    save_model(file, model, facts)
    say(f"meta-trained on {method.env_steps:,} environment steps -> {file}")
    return model


def train_meta_il(
    seed: int, learning: MethodConfig, demonstrations: DemonstrationDataset, folder: RunFolder
) -> PEMIRLModel:
    """Meta-IL's encoder and policy, to ``meta_il.safetensors``."""
    torch.manual_seed(seed)
    # It has no use for the reward, which is the same for all methods that share it.
    model = new_model(demonstrations, MethodConfig(model=learning.model), reward="shaped")
    given: MetaILConfig = learning.meta_il
    method = MetaIL(model, demonstrations.trajectories(), given)
    folder.train("meta-il", method, show="meta_il/loss_imitation")
    save_model(folder.file("meta_il.safetensors"), model, {"method": "meta_il", "env_steps": "0"})
    return model


def task_space(settings: Settings) -> list[int]:
    """Which components of an observation the task is about."""
    return pemirl_envs.get_task(settings.environment).task_space_indices()


def build_method(
    settings: Settings, model: PEMIRLModel, demonstrations: DemonstrationDataset
) -> Method:
    """The adversarial method, on its environment."""
    learning, pile = settings.learning, demonstrations.trajectories()
    rollouts = learning.training.rollouts_per_context
    transform = InferContext(
        model.encoder,
        pile,
        rollouts_per_context=rollouts,
        # The environment is reset to the demonstrated task, so that its reward is a metric.
        tasks=None if demonstrations.task is None else demonstrations.tasks(),
    )
    env = environment(
        settings.environment,
        learning.contexts_per_batch * rollouts,
        transform,
        seed=settings.seed,
        threads=settings.threads,
    )
    other = None
    if settings.info_estimator == "public_code" and isinstance(learning.training, PEMIRLConfig):
        other = PublicCodeInfoLoss(model, pile, learning.training)
    return build(learning, model, env, pile, info_loss=other)


def check_sizes(settings: Settings, demonstrations: DemonstrationDataset) -> None:
    """Compare S, A and T before anything is trained.

    Raises:
        RunRefused: demonstrations and environment do not fit together; names both.
    """
    for name in (settings.environment, settings.test_environment):
        task = pemirl_envs.get_task(name)
        wanted = (task.observation_size, len(task.action_bounds[0]), task.horizon)
        got = (demonstrations.observation_dim, demonstrations.action_dim, demonstrations.horizon)
        if got != wanted:
            raise RunRefused(
                f"{settings.demonstrations} holds demonstrations of (S, A, T) = {got}, but {name} "
                f"has {wanted}"
            )
