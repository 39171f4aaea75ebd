"""Infer r(s, m) of new tasks from one demonstration each, and train a policy on it (Algorithm 2).

    pemirl adapt_reward model_file=runs/my_run/model.safetensors
    pemirl adapt_reward experiment=ant       # of the run of pemirl meta_train experiment=ant
    pemirl adapt_reward method=airl          # of the run of pemirl meta_train method=airl
    pemirl adapt_reward test_demonstrations=my_demonstration.safetensors

Writes ``policy.safetensors`` and the learning curve to ``run_dir``. Rewards are the learned ones;
true returns, where the demonstrations come with their tasks, are metrics.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import torch
from pydantic.dataclasses import dataclass
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase

from pemirl_lab.commands.meta_train import check_sizes
from pemirl_lab.measuring.rollouts import environment, of_demonstrations, true_reward_module
from pemirl_lab.measuring.scores import load_test_demonstrations
from pemirl_lab.runs.places import data_file, run_file
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import ContextPolicy, PEMIRLModel
from pemirl_trl.configuration import CHECKED
from pemirl_trl.files import load_weights, read_metadata, save_weights
from pemirl_trl.methods import PolicyOptimization, PolicyOptimizationConfig, initial_policy
from pemirl_trl.pretrained import load_model


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own: the model whose reward is adapted to."""

    model_file: str


def run(settings: Settings, own: Own) -> ContextPolicy:
    """Adapt in the folder that the settings name."""
    folder = RunFolder.of(settings)
    model = load_model(folder.reads("model", run_file(own.model_file, "meta_train")))
    return adapt(settings, folder, model)[0]


def adapt(
    settings: Settings,
    folder: RunFolder,
    model: PEMIRLModel,
    *,
    environment_name: str | None = None,
    stage: str = "adaptation",
    true_reward: bool = False,
) -> tuple[ContextPolicy, int]:
    """Train a policy on the learned reward under the test environment's dynamics.

    Args:
        settings: of the run.
        folder: of the run; the weights go to ``policy.safetensors``, or ``<stage>.safetensors`` of
            another stage.
        model: encoder and reward.
        environment_name: other dynamics than the test environment's.
        stage: names checkpoints and curve.
        true_reward: train on the true reward instead: the oracle to compare with.

    Returns:
        The policy, and the environment steps it took.
    """
    torch.manual_seed(settings.seed)
    name = environment_name or settings.test_environment
    folder.reads("test demonstrations", data_file(settings.test_demonstrations))
    demonstrations = load_test_demonstrations(settings)
    check_sizes(settings, demonstrations)
    rollouts = max(1, settings.adaptation.rollouts // len(demonstrations))
    transform = of_demonstrations(model, demonstrations, rollouts)
    count = len(demonstrations) * rollouts
    env = environment(name, count, transform, seed=settings.seed, threads=settings.threads)
    policy, activation = initial_policy(model, settings.adaptation)
    reward, keys, optimization = _objective(settings, model, name, true_reward)
    method = PolicyOptimization(
        env,
        policy,
        model.horizon,
        optimization,
        rollouts_per_context=rollouts,
        reward=reward,
        task_keys=keys,
    )
    folder.train(stage, method, show="return/true")
    file = folder.file("policy.safetensors" if stage == "adaptation" else f"{stage}.safetensors")
    facts = {"environment": name, "env_steps": str(method.env_steps), "activation": activation}
    save_weights(file, {"policy": policy}, facts)
    say(f"{stage}: trained on {method.env_steps:,} environment steps -> {file}")
    return policy, method.env_steps


def _objective(
    settings: Settings, model: PEMIRLModel, name: str, true_reward: bool
) -> tuple[TensorDictModuleBase | None, tuple[NestedKey, ...], PolicyOptimizationConfig]:
    """The reward (None: the environment's), what tells tasks apart to it, and the settings."""
    optimization = settings.adaptation.optimization
    if not true_reward:
        return model.reward, ("context",), optimization
    keys: tuple[NestedKey, ...] = ("context", ("task", settings.task_key))
    if settings.planar:  # known as a function: the oracle's optimiser is the same
        return true_reward_module(name), keys, optimization
    return None, keys, dataclasses.replace(optimization, imitate_best=0.0)


def load_adapted(file: Path, model: PEMIRLModel) -> tuple[ContextPolicy, int]:
    """The policy of a file that :func:`adapt` wrote, and the environment steps it took.

    Raises:
        ValueError: the file holds something else.
    """
    facts = read_metadata(file)
    if not {"activation", "env_steps"} <= set(facts):
        raise ValueError(f"{file} holds weights of {sorted(facts)}; expected an adapted policy")
    policy = model.new_policy(activation=facts["activation"])
    load_weights(file, {"policy": policy})
    return policy, int(facts["env_steps"])
