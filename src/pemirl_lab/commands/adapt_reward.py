"""Infer r(s, m) of new tasks from one demonstration each, and train a policy on it (Algorithm 2).

    python recipes/adapt_reward.py model_file=runs/my_run/model.safetensors
    python recipes/adapt_reward.py task=ant          # of the run of meta_train.py task=ant
    python recipes/adapt_reward.py trained=pemirl    # of the run of meta_train.py method=pemirl
    python recipes/adapt_reward.py test_demonstrations=my_demonstration.safetensors

Writes ``policy.safetensors`` and the learning curve to ``run_dir``. Rewards are the learned ones;
true returns, where the demonstrations come with their tasks, are metrics.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import hydra
import torch
from config import typed
from domains import data_file, environment, one_per_task, run_file, true_reward_module
from omegaconf import DictConfig
from run_folder import RunFolder, say
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase

from pemirl_trl import ContextPolicy, DemonstrationDataset, InferContext, PEMIRLModel
from pemirl_trl.files import load_weights, read_metadata, save_weights
from pemirl_trl.methods import PolicyOptimization, PolicyOptimizationConfig
from pemirl_trl.pretrained import load_model


def load_test_demonstrations(config: DictConfig) -> DemonstrationDataset:
    """One demonstration of each test task."""
    demonstrations = DemonstrationDataset.load(data_file(config.test_demonstrations))
    return one_per_task(demonstrations, config.demonstrations_per_task)


def adapt(
    config: DictConfig,
    folder: RunFolder,
    model: PEMIRLModel,
    *,
    environment_name: str | None = None,
    stage: str = "adaptation",
    true_reward: bool = False,
) -> tuple[ContextPolicy, int]:
    """Train a policy on the learned reward under the test environment's dynamics.

    Args:
        config: of the run.
        folder: of the run; the weights go to ``policy.safetensors``, or ``<stage>.safetensors`` of
            another stage.
        model: encoder and reward.
        environment_name: other dynamics than the test environment's.
        stage: names checkpoints and curve.
        true_reward: train on the true reward instead: the oracle to compare with.

    Returns:
        The policy, and the environment steps it took.
    """
    torch.manual_seed(config.seed)
    name = environment_name or config.test_environment
    demonstrations = load_test_demonstrations(config)
    rollouts = max(1, config.adaptation.rollouts // len(demonstrations))
    transform = InferContext(
        model.encoder,
        demonstrations.trajectories(),
        rollouts_per_context=rollouts,
        draw="all",
        sample=False,
        tasks=None if demonstrations.task is None else demonstrations.tasks(),
    )
    count = len(demonstrations) * rollouts
    env = environment(name, count, transform, seed=config.seed, threads=config.threads)
    policy, activation = initial_policy(config, model)
    reward, keys, settings = _objective(config, model, name, true_reward)
    method = PolicyOptimization(
        env,
        policy,
        model.horizon,
        settings,
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
    config: DictConfig, model: PEMIRLModel, name: str, true_reward: bool
) -> tuple[TensorDictModuleBase | None, tuple[NestedKey, ...], PolicyOptimizationConfig]:
    """The reward (None: the environment's), what tells tasks apart to it, and the settings."""
    settings = typed(PolicyOptimizationConfig, config.adaptation.optimization)
    if not true_reward:
        return model.reward, ("context",), settings
    keys: tuple[NestedKey, ...] = ("context", ("task", config.task_key))
    if config.planar:  # known as a function: the oracle's optimiser is the same
        return true_reward_module(name, config.task_key), keys, settings
    return None, keys, dataclasses.replace(settings, imitate_best=0.0)


def initial_policy(config: DictConfig, model: PEMIRLModel) -> tuple[ContextPolicy, str]:
    """The policy that adaptation starts from, and its activation.

    Raises:
        ValueError: ``adaptation.initial_policy`` is neither fresh nor trained.
    """
    given = config.adaptation
    sizes = {"scale": given.policy_scale, "learn_scale": given.learn_policy_scale}
    if given.initial_policy == "fresh":
        policy = model.new_policy(**sizes, activation=given.policy_activation)
        return policy, given.policy_activation
    if given.initial_policy == "trained":
        return model.trained_policy(**sizes), "relu"
    raise ValueError(
        f"unknown adaptation.initial_policy {given.initial_policy!r}; choose fresh or trained"
    )


def load_adapted(file: Path, model: PEMIRLModel) -> tuple[ContextPolicy, int]:
    """The policy of a file that :func:`adapt` wrote, and the environment steps it took."""
    facts = read_metadata(file)
    policy = model.new_policy(activation=facts["activation"])
    load_weights(file, {"policy": policy})
    return policy, int(facts["env_steps"])


@hydra.main(config_path="conf", config_name="adapt_reward", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    model = load_model(run_file(config.model_file, "meta_train.py"))
    adapt(config, RunFolder(config), model)


if __name__ == "__main__":
    main()
