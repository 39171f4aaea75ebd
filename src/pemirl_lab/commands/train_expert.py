"""Train an expert on the true reward: TRPO with a policy that reads the task.

    python recipes/train_expert.py
    python recipes/train_expert.py environment=point_maze/right output=my_expert.safetensors
    python recipes/train_expert.py task=ant

Writes the policy's weights to ``output``; everything else goes to ``run_dir``.
"""

from __future__ import annotations

import hydra
import torch
from config import typed
from domains import environment, expert_policy, returns_given_tasks, split_sampler
from omegaconf import DictConfig
from run_folder import RunFolder, say

import pemirl_envs
from pemirl_trl import SampleTasks
from pemirl_trl.files import save_weights
from pemirl_trl.methods import PolicyOptimization, PolicyOptimizationConfig


def train_expert(config: DictConfig, folder: RunFolder) -> float:
    """Train, save to ``config.output``, and return the mean return on the test tasks."""
    torch.manual_seed(config.seed)
    task = config.environment
    rollouts = config.rollouts_per_task
    env = environment(
        task,
        config.tasks_per_batch * rollouts,
        SampleTasks(split_sampler(task, config.split), rollouts_per_task=rollouts),
        seed=config.seed,
        threads=config.threads,
    )
    policy = expert_policy(task, config.task_key, config.policy)
    method = PolicyOptimization(
        env,
        policy,
        pemirl_envs.get_task(task).horizon,
        typed(PolicyOptimizationConfig, config.optimization),
        rollouts_per_context=rollouts,
    )
    folder.train("expert", method, show="return/true")
    tasks = pemirl_envs.task_parameters(task, "test")
    returns = returns_given_tasks(task, policy, tasks, config)
    output = config.output or config.experts[task.split("/")[1]]
    save_weights(
        output,
        {"policy": policy},
        {
            "environment": task,
            "task_key": config.task_key,
            "hidden": ",".join(map(str, config.policy.hidden)),
            "activation": config.policy.activation,
            "standardize_task": str(config.policy.standardize_task),
            "seed": str(config.seed),
            "env_steps": str(method.env_steps),
            "test_return": f"{float(returns.mean()):.4f}",
        },
    )
    say(f"expert on {task}: {float(returns.mean()):.2f} over the test tasks -> {output}")
    return float(returns.mean())


@hydra.main(config_path="conf", config_name="train_expert", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    train_expert(config, RunFolder(config))


if __name__ == "__main__":
    main()
