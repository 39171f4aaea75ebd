"""Meta-train q(m | demonstration), r(s, m) and a policy on unlabelled demonstrations.

    pemirl meta_train
    pemirl meta_train experiment=ant
    pemirl meta_train method=airl seed=1
    pemirl meta_train training.info_coeff=0 model.context_dim=5 run_dir=runs/no_info
    pemirl meta_train demonstrations=FILE env=my_module:make_env run_dir=runs/mine

With ``env=`` it is an environment of your own: the settings follow from the demonstrations, any of
them can be given (``training.iterations=100``), and ``preset=`` is one of the library's (robust,
contrastive with ``task_space=[0,1]``, paper).

Writes ``model.safetensors`` and, where the method has contexts, ``meta_il.safetensors`` (Meta-IL:
a baseline, and what initialises the encoder) to ``run_dir``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from functools import partial

import torch
from pydantic.dataclasses import dataclass
from torchrl.envs import EnvBase

import pemirl_envs
from pemirl_lab.measuring.rollouts import environment
from pemirl_lab.pages.drawing import draw_known_maps
from pemirl_lab.pages.run_page import write_run_page
from pemirl_lab.public_code import PublicCodeInfoLoss
from pemirl_lab.runs.own_task import OwnTask, load_make_env
from pemirl_lab.runs.places import RunRefused, data_file
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset, InferContext, PEMIRLModel
from pemirl_trl.configuration import CHECKED, Index
from pemirl_trl.data import examine
from pemirl_trl.methods import (
    MetaIL,
    MetaILConfig,
    MethodConfig,
    PEMIRLConfig,
    WorkerCollector,
    build,
    meta_train_in_stages,
    meta_training_config,
    new_model,
    start_from,
    training_family,
)
from pemirl_trl.methods.consistency import measured
from pemirl_trl.methods.defaults import found_for_meta_training, table
from pemirl_trl.methods.loop import Method
from pemirl_trl.methods.worker_collection import shares_of
from pemirl_trl.pretrained import save_model

LEARNED = "return/learned"


@dataclass(frozen=True, config=CHECKED)
class Own:
    """This command has nothing of its own."""


def run(settings: Settings, own: Own) -> PEMIRLModel:
    """Meta-train in the folder that the settings name."""
    folder = RunFolder.of(settings)
    model = meta_train(settings, folder)
    demonstrations = DemonstrationDataset.load(data_file(settings.demonstrations))
    maps = folder.file("figures/reward_maps.png")
    draw_known_maps(settings.environment, model, demonstrations, maps)
    write_run_page(folder.path)
    return model


@dataclass(frozen=True, config=CHECKED)
class OwnEnvironment(OwnTask):
    """The values of this command with an environment of the user's own."""

    demonstrations: str = field(kw_only=True)
    preset: str = "robust"
    task_space: Sequence[Index] | None = None


def settings_found(task: OwnEnvironment) -> str:
    """A table of the settings that follow from the demonstrations, with the values in use."""
    data = task.demonstrations_in(data_file(task.demonstrations))
    config = meta_training_config(data, task.preset, task.settings)
    return table(found_for_meta_training(data, task.preset, task.settings), config)


def run_own(task: OwnEnvironment) -> PEMIRLModel:
    """Meta-train on an environment of the user's own; there is no ground truth to show."""
    make_env = load_make_env(task.env)
    path = data_file(task.demonstrations)
    data = task.demonstrations_in(path)
    config = meta_training_config(data, task.preset, task.settings)
    folder = task.when_begun({"demonstrations": path})
    say_findings(task.demonstrations, data)
    say(table(found_for_meta_training(data, task.preset, task.settings), config))

    def stage(name: str, method: Method, /) -> None:
        show = "meta_il/loss_imitation" if name == "meta-il" else LEARNED
        folder().train(name, method, show=show)

    model = meta_train_in_stages(
        *(make_env, data, config, stage),
        seed=task.seed,
        device=task.device,
        task_space=task.task_space,
        observation_keys=task.observation_keys,
    )
    steps = config.contexts_per_batch * config.training.rollouts_per_context * data.horizon
    facts = {"method": task.preset, "env_steps": str(steps * config.training.iterations)}
    file = folder().file("model.safetensors")
    save_model(file, model, facts)
    if model.family is not None and (found := measured(model.family)):
        say(found)
    say(f"meta-trained on {steps * config.training.iterations:,} environment steps -> {file}")
    write_run_page(folder().path)
    return model


def load_demonstrations(file: str, folder: RunFolder) -> DemonstrationDataset:
    """The unlabelled pile; what is suspicious about it is said, once a run."""
    path = data_file(file)
    demonstrations = DemonstrationDataset.load(path)
    folder.reads("demonstrations", path)
    say_findings(file, demonstrations)
    return demonstrations


def say_findings(file: str, demonstrations: DemonstrationDataset) -> None:
    """Say what is suspicious about demonstrations."""
    for finding in examine(demonstrations):
        say(f"{file}: {finding}")


def meta_train(
    settings: Settings, folder: RunFolder, meta_il: PEMIRLModel | None = None
) -> PEMIRLModel:
    """Meta-IL, where the method has contexts and it is not given; then the method."""
    learning = settings.learning
    demonstrations = load_demonstrations(settings.demonstrations, folder)
    check_sizes(settings, demonstrations)
    if meta_il is None and learning.model.context_dim > 0:
        meta_il = train_meta_il(settings, demonstrations, folder)
    if learning.algorithm == "meta_il" and meta_il is not None:
        return meta_il
    torch.manual_seed(settings.seed)
    model = new_model(demonstrations, learning, task_space=task_space(settings))
    start_from(model, meta_il, learning)
    env = open_environment(settings, model.to(settings.device), demonstrations)
    try:
        method = build_method(settings, model, demonstrations, env)
        folder.train(settings.method, method, show="return/true")
    finally:
        env.close()
    model.cpu()
    if learning.model.context_dim > 0:
        model.family = training_family(model, demonstrations)
    facts = {"method": settings.method, "env_steps": str(method.env_steps)}
    file = folder.file("model.safetensors")
    save_model(file, model, facts)
    say(f"meta-trained on {method.env_steps:,} environment steps -> {file}")
    return model


def train_meta_il(
    settings: Settings, demonstrations: DemonstrationDataset, folder: RunFolder
) -> PEMIRLModel:
    """Meta-IL's encoder and policy, to ``meta_il.safetensors``."""
    learning = settings.learning
    torch.manual_seed(settings.seed)
    # It has no use for the reward, which is the same for all methods that share it.
    model = new_model(demonstrations, MethodConfig(model=learning.model), reward="shaped")
    given: MetaILConfig = learning.meta_il
    method = MetaIL(model.to(settings.device), demonstrations.trajectories(), given)
    folder.train("meta-il", method, show="meta_il/loss_imitation")
    model.cpu()
    save_model(folder.file("meta_il.safetensors"), model, {"method": "meta_il", "env_steps": "0"})
    return model


def task_space(settings: Settings) -> list[int]:
    """Which components of an observation the task is about."""
    return pemirl_envs.get_task(settings.environment).task_space_indices()


def build_method(
    settings: Settings,
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    env: EnvBase | WorkerCollector,
) -> Method:
    """The adversarial method, on its environment or on the workers that have parts of it."""
    learning, pile = settings.learning, demonstrations.trajectories()
    other = None
    if settings.info_estimator == "public_code" and isinstance(learning.training, PEMIRLConfig):
        other = PublicCodeInfoLoss(model, pile, learning.training)
    return build(learning, model, env, pile, info_loss=other)


def open_environment(
    settings: Settings, model: PEMIRLModel, demonstrations: DemonstrationDataset
) -> EnvBase | WorkerCollector:
    """Where the rollouts come from: an environment in this process, or workers with parts of it.

    Raises:
        RunRefused: these workers cannot be had; says why.
    """
    contexts = settings.learning.contexts_per_batch
    make_env = partial(training_environment, settings, demonstrations)
    if settings.workers == 0:
        return make_env(model, contexts)
    try:
        shares = shares_of(contexts, settings.workers)
        return WorkerCollector(make_env, model, shares, cpus=settings.threads)
    except (ImportError, ValueError) as error:
        raise RunRefused(f"workers={settings.workers}: {error}") from error


def training_environment(
    settings: Settings, demonstrations: DemonstrationDataset, model: PEMIRLModel, contexts: int
) -> EnvBase:
    """The environment of so many contexts, which the model's encoder infers."""
    rollouts = settings.learning.training.rollouts_per_context
    transform = InferContext(
        model.encoder,
        demonstrations.trajectories(),
        rollouts_per_context=rollouts,
        # The environment is reset to the demonstrated task, so that its reward is a metric.
        tasks=None if demonstrations.task is None else demonstrations.tasks(),
    )
    return environment(
        settings.environment,
        contexts * rollouts,
        transform,
        seed=settings.seed,
        threads=settings.threads,
    )


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
