"""Roll an expert out into demonstrations, so many per task of a split.

    python recipes/collect_demos.py
    python recipes/collect_demos.py split=test output=data/point_maze_test.safetensors

Writes one safetensors file to ``output``. Actions are drawn from the expert's distribution, as
maximum-entropy IRL assumes. Task parameters are stored for metrics; no learner reads them.
"""

from __future__ import annotations

import hydra
import torch
from domains import data_file, environment, given_tasks, load_expert, random_rollouts
from omegaconf import DictConfig
from run_folder import say
from torchrl.envs import ExplorationType, set_exploration_type

import pemirl_envs
from pemirl_trl import DemonstrationDataset, Provenance, SampleTasks, __version__
from pemirl_trl.files import read_metadata


@torch.no_grad()
def collect_demos(config: DictConfig) -> DemonstrationDataset:
    """Collect and save; ``per_task`` demonstrations of each task stand in a row."""
    torch.manual_seed(config.seed)
    task = config.environment
    tasks = pemirl_envs.task_parameters(task, config.split)
    env = environment(
        task,
        tasks.batch_size[0] * config.per_task,
        SampleTasks(given_tasks(tasks), rollouts_per_task=config.per_task),
        seed=config.seed,
        threads=config.threads,
    )
    horizon = pemirl_envs.get_task(task).horizon
    path = config.expert or config.experts[task.split("/")[1]]
    # Loading once took these random steps. The published files were drawn after them, and the
    # commands on their cards still make them.
    random_rollouts(read_metadata(data_file(path))["environment"])
    expert = load_expert(path)
    with set_exploration_type(ExplorationType.RANDOM):
        rollouts = env.rollout(horizon, expert, break_when_any_done=False)
    mean_return = float(rollouts["next", "reward"].sum(1).mean())
    demonstrations = DemonstrationDataset.from_rollouts(
        rollouts,
        Provenance(
            environment=task,
            seed=config.seed,
            expert_return=mean_return,
            code_version=__version__,
            command=(
                f"recipes/collect_demos.py split={config.split} per_task={config.per_task} "
                f"seed={config.seed}"
            ),
            extra={"split": config.split, "per_task": str(config.per_task)},
        ),
    )
    demonstrations.save(config.output)
    say(
        f"{len(demonstrations)} demonstrations of {tasks.batch_size[0]} tasks, mean return "
        f"{mean_return:.2f} -> {config.output}"
    )
    return demonstrations


@hydra.main(config_path="conf", config_name="collect_demos", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    collect_demos(config)


if __name__ == "__main__":
    main()
