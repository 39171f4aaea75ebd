"""Film the adapted policy on a few unseen tasks, with MuJoCo's own renderer.

    MUJOCO_GL=osmesa python recipes/record_video.py run=runs/quickstart/pemirl_blurred/seed0

Writes ``output`` (mp4). Headless rendering needs Debian's ``libosmesa6``.
"""

from __future__ import annotations

import hydra
import torch
from adapt_reward import load_adapted, load_test_demonstrations
from domains import data_file, environment
from omegaconf import DictConfig
from run_folder import say
from tensordict import TensorDictBase
from torchrl.envs import ExplorationType, set_exploration_type

import pemirl_envs
from pemirl_envs.rendering import render, write_video
from pemirl_trl import InferContext
from pemirl_trl.pretrained import load_model


@torch.no_grad()
def record_video(config: DictConfig) -> None:
    """Roll the policy out, one episode after the other, and film it."""
    model = load_model(data_file(f"{config.run}/model.safetensors"))
    policy, _ = load_adapted(data_file(f"{config.run}/policy.safetensors"), model)
    demonstrations = load_test_demonstrations(config)
    chosen = torch.linspace(0, len(demonstrations) - 1, config.tasks).round().long()
    few = demonstrations[chosen]
    transform = InferContext(
        model.encoder, few.trajectories(), draw="all", sample=False, tasks=few.tasks()
    )
    task = pemirl_envs.get_task(config.test_environment)
    env = environment(
        config.test_environment, len(few), transform, seed=config.seed, threads=config.threads
    )
    states = []

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        states.append(env.base_env.physics_state())
        return policy(tensordict)

    with set_exploration_type(ExplorationType.DETERMINISTIC):
        env.rollout(model.horizon, act, break_when_any_done=False)
    film = torch.stack(states, 1).flatten(0, 1)  # [tasks * T, n_state]
    write_video(config.output, render(task, film), fps=1 / task.control_timestep)
    say(f"{len(few)} episodes -> {config.output}")


@hydra.main(config_path="conf", config_name="record_video", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    record_video(config)


if __name__ == "__main__":
    main()
