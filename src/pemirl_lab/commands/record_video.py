"""Film a policy on a few unseen tasks, with MuJoCo's own renderer.

    export MUJOCO_GL=osmesa
    python recipes/record_video.py run=runs/quickstart/point_maze/pemirl_robust/seed0
    python recipes/record_video.py task=ant policy=expert output=ant.mp4

Writes ``output`` (mp4). Headless rendering needs Debian's ``libosmesa6``.
"""

from __future__ import annotations

from collections.abc import Callable

import hydra
import torch
from adapt_reward import load_adapted, load_test_demonstrations
from domains import environment, given_tasks, load_expert, run_file
from omegaconf import DictConfig
from run_folder import say
from tensordict import TensorDictBase
from torchrl.envs import ExplorationType, Transform, set_exploration_type

import pemirl_envs
from pemirl_envs.rendering import render, write_video
from pemirl_trl import InferContext, SampleTasks
from pemirl_trl.pretrained import load_model

Actor = Callable[[TensorDictBase], TensorDictBase]


def adapted(config: DictConfig) -> tuple[Actor, Transform, int]:
    """An adapted policy, what writes its contexts, and the number of tasks."""
    model = load_model(run_file(config.model_file, "quickstart.py or meta_train.py"))
    file = run_file(config.policy_file, "quickstart.py or adapt_reward.py")
    policy, _ = load_adapted(file, model)
    demonstrations = load_test_demonstrations(config)
    few = demonstrations[_spread(len(demonstrations), config.tasks)]
    transform = InferContext(
        model.encoder, few.trajectories(), draw="all", sample=False, tasks=few.tasks()
    )
    return policy, transform, len(few)


def expert(config: DictConfig) -> tuple[Actor, Transform, int]:
    """The expert under the test dynamics, what writes its tasks, and their number."""
    tasks = pemirl_envs.task_parameters(config.test_environment, "test")
    few = tasks[_spread(len(tasks), config.tasks)]
    policy = load_expert(config.experts[config.test_environment.split("/")[1]])
    return policy, SampleTasks(given_tasks(few), rollouts_per_task=1), len(few)


POLICIES = {"adapted": adapted, "expert": expert}


def _spread(available: int, wanted: int) -> torch.Tensor:
    return torch.linspace(0, available - 1, min(available, wanted)).round().long()


@torch.no_grad()
def record_video(config: DictConfig) -> None:
    """Roll the policy out, one episode after the other, and film it.

    Raises:
        ValueError: there is no such policy; names the legal ones.
    """
    if config.policy not in POLICIES:
        raise ValueError(f"unknown policy {config.policy!r}; choose one of {sorted(POLICIES)}")
    policy, transform, count = POLICIES[config.policy](config)
    task = pemirl_envs.get_task(config.test_environment)
    env = environment(
        config.test_environment, count, transform, seed=config.seed, threads=config.threads
    )
    states = []

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        states.append(env.base_env.physics_state())
        return policy(tensordict)

    with set_exploration_type(ExplorationType.DETERMINISTIC):
        env.rollout(task.horizon, act, break_when_any_done=False)
    film = torch.stack(states[:: config.every], 1).flatten(0, 1)  # [tasks * frames, n_state]
    size = {"width": config.width, "height": config.height, "camera": config.camera}
    fps = 1 / (task.control_timestep * config.every)
    write_video(config.output, render(task, film, **size), fps=fps)
    say(f"{count} episodes -> {config.output}")


@hydra.main(config_path="conf", config_name="record_video", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    record_video(config)


if __name__ == "__main__":
    main()
