"""Train an expert on the true reward: TRPO with a policy that reads the task.

    pemirl train_expert
    pemirl train_expert environment=point_maze/right output=my_expert.safetensors
    pemirl train_expert task=ant

Writes the policy's weights to ``output``; everything else goes to ``run_dir``.
"""

from __future__ import annotations

import torch
from pydantic.dataclasses import dataclass

import pemirl_envs
from pemirl_lab.measuring.experts import expert_facts, new_expert
from pemirl_lab.measuring.rollouts import (
    environment,
    evaluation_episodes,
    of_tasks,
    split_sampler,
)
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import SampleTasks
from pemirl_trl.configuration import CHECKED
from pemirl_trl.evaluation import returns_per_task
from pemirl_trl.files import save_weights
from pemirl_trl.methods import PolicyOptimization


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own: where the weights go; None: where the task looks."""

    output: str | None = None


def run(settings: Settings, own: Own) -> float:
    """Train, save, and return the mean return on the test tasks."""
    folder = RunFolder.of(settings)
    torch.manual_seed(settings.seed)
    name, given = settings.environment, settings.expert_training
    output = own.output or settings.expert_file(name)
    env = environment(
        name,
        given.tasks_per_batch * given.rollouts_per_task,
        SampleTasks(split_sampler(name, given.split), rollouts_per_task=given.rollouts_per_task),
        seed=settings.seed,
        threads=settings.threads,
    )
    policy = new_expert(name, given.policy).to(settings.device)
    horizon = pemirl_envs.get_task(name).horizon
    method = PolicyOptimization(
        env, policy, horizon, given.optimization, rollouts_per_context=given.rollouts_per_task
    )
    folder.train("expert", method, show="return/true")
    policy.cpu()
    tasks, episodes = pemirl_envs.task_parameters(name, "test"), settings.evaluation.episodes
    rollouts = evaluation_episodes(settings, name, policy, of_tasks(tasks, episodes), len(tasks))
    reached = float(returns_per_task(rollouts, episodes).mean())
    facts = {
        **expert_facts(name, given.policy),
        "seed": str(settings.seed),
        "env_steps": str(method.env_steps),
        "test_return": f"{reached:.4f}",
    }
    save_weights(output, {"policy": policy}, facts)
    say(f"expert on {name}: {reached:.2f} over the test tasks -> {output}")
    return reached
