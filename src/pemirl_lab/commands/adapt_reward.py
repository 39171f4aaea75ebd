"""Infer r(s, m) of new tasks from one demonstration each, and train a policy on it (Algorithm 2).

    pemirl adapt_reward model_file=runs/my_run/model.safetensors
    pemirl adapt_reward experiment=ant       # of the run of pemirl meta_train experiment=ant
    pemirl adapt_reward method=airl          # of the run of pemirl meta_train method=airl
    pemirl adapt_reward test_demonstrations=my_demonstration.safetensors
    pemirl adapt_reward model_file=M test_demonstrations=ONE env=my:make_env

With ``env=`` it is an environment of your own, and the settings follow from the demonstrations; see
``pemirl meta_train``. Short tries choose the start, unless ``initial_policy=`` says it, and how
widely to explore, unless ``exploration=`` does; ``adaptation.json`` tells what came out.

Writes ``policy.safetensors`` and the learning curve to ``run_dir``. Rewards are the learned ones;
true returns, where the demonstrations come with their tasks, are metrics.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import field

import torch
from pydantic.dataclasses import dataclass
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from pemirl_lab.commands.meta_train import check_sizes
from pemirl_lab.measuring.rollouts import environment, of_demonstrations, true_reward_module
from pemirl_lab.measuring.scores import load_test_demonstrations
from pemirl_lab.pages.drawing import draw_known_maps
from pemirl_lab.pages.run_page import write_run_page
from pemirl_lab.runs.own_task import OwnTask, load_make_env
from pemirl_lab.runs.places import data_file, run_file
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import Adaptation, PEMIRLModel
from pemirl_trl.configuration import CHECKED
from pemirl_trl.methods import (
    Candidate,
    PolicyOptimization,
    PolicyOptimizationConfig,
    adapt_in_stages,
    candidates,
    initial_policy,
    objective,
)
from pemirl_trl.methods.defaults import Exploration
from pemirl_trl.methods.diagnostics import Diagnostics
from pemirl_trl.methods.loop import Method
from pemirl_trl.modules.model import Policy
from pemirl_trl.pretrained import load_model
from pemirl_trl.sharing import save_policy


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own: the model whose reward is adapted to."""

    model_file: str


def run(settings: Settings, own: Own) -> Policy:
    """Adapt in the folder that the settings name."""
    folder = RunFolder.of(settings)
    model = load_model(folder.reads("model", run_file(own.model_file, "meta_train")))
    policy, _ = adapt(settings, folder, model)
    demonstrations, maps = (
        load_test_demonstrations(settings),
        folder.file("figures/reward_maps.png"),
    )
    draw_known_maps(settings.test_environment, model, demonstrations, maps)
    write_run_page(folder.path)
    return policy


@dataclass(frozen=True, config=CHECKED)
class OwnEnvironment(OwnTask):
    """The values of this command with an environment of the user's own."""

    model_file: str = field(kw_only=True)
    test_demonstrations: str = field(kw_only=True)
    exploration: Exploration | None = None


def settings_found(task: OwnEnvironment) -> str:
    """Tables of the settings that follow from the demonstrations, by exploration."""
    model = load_model(run_file(task.model_file, "meta_train"))
    data = task.demonstrations_in(data_file(task.test_demonstrations))
    return _tables(candidates(model, data, task.settings, task.exploration))


def _tables(ways: Sequence[Candidate]) -> str:
    by_exploration = {way.exploration: way.settings for way in ways}
    return "\n".join(f"exploration {name}:\n{found}" for name, found in by_exploration.items())


def run_own(task: OwnEnvironment) -> Adaptation:
    """Adapt in an environment of the user's own; there is no ground truth to show."""
    make_env = load_make_env(task.env)
    model_path = run_file(task.model_file, "meta_train")
    model, data_path = load_model(model_path), data_file(task.test_demonstrations)
    data = task.demonstrations_in(data_path)
    ways = candidates(model, data, task.settings, task.exploration)
    folder = task.when_begun({"model": model_path, "test demonstrations": data_path})
    say(_tables(ways))

    def stage(name: str, method: Method, /) -> None:
        folder().train(name, method, show="return/learned")

    result = adapt_in_stages(
        *(model, data, make_env, ways, stage),
        seed=task.seed,
        device=task.device,
        observation_keys=task.observation_keys,
    )
    file = folder().file("policy.safetensors")
    result.save(file, {"environment": task.env})
    told = ("kept", "start", "exploration", "tries", "learned_return", "carried_over_return")
    record = {name: getattr(result, name) for name in (*told, "env_steps", "warnings")}
    folder().write_json("adaptation.json", record)
    say(f"{result}\n-> {file}")
    write_run_page(folder().path)
    return result


def adapt(
    settings: Settings,
    folder: RunFolder,
    model: PEMIRLModel,
    *,
    environment_name: str | None = None,
    stage: str = "adaptation",
    true_reward: bool = False,
) -> tuple[Policy, int]:
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
    # The oracle's reward is the task's own: a function of the CPU.
    device = "cpu" if true_reward else settings.device
    policy, activation = initial_policy(model.to(device), settings.adaptation)
    policy.to(device)
    reward, keys, optimization = _objective(settings, model, name, env, true_reward)
    diagnostics = None
    if not true_reward:
        shown = demonstrations.trajectories()
        diagnostics = Diagnostics(model, shown, rollouts, reward_is_learned=False)
    method = PolicyOptimization(
        env,
        policy,
        model.horizon,
        optimization,
        rollouts_per_context=rollouts,
        reward=reward,
        task_keys=keys,
        diagnostics=diagnostics,
    )
    folder.train(stage, method, show="return/true")
    model.cpu()
    policy.cpu()
    file = folder.file("policy.safetensors" if stage == "adaptation" else f"{stage}.safetensors")
    facts = {"environment": name, "env_steps": str(method.env_steps)}
    save_policy(file, policy, activation, facts)
    say(f"{stage}: trained on {method.env_steps:,} environment steps -> {file}")
    return policy, method.env_steps


def _objective(
    settings: Settings, model: PEMIRLModel, name: str, env: EnvBase, true_reward: bool
) -> tuple[TensorDictModuleBase | None, tuple[NestedKey, ...], PolicyOptimizationConfig]:
    """The reward (None: the environment's), what tells tasks apart to it, and the settings."""
    optimization = settings.adaptation.optimization
    if not true_reward:
        return objective(model, settings.adaptation, env), ("context",), optimization
    keys: tuple[NestedKey, ...] = ("context", ("task", settings.task_key))
    if settings.planar:  # known as a function: the oracle's optimiser is the same
        return true_reward_module(name), keys, optimization
    return None, keys, dataclasses.replace(optimization, imitate_best=0.0)
