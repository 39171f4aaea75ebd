"""Film a policy on a few unseen tasks, with MuJoCo's own renderer.

    export MUJOCO_GL=osmesa
    pemirl record_video run=runs/quickstart/point_maze/pemirl_robust/seed0
    pemirl record_video task=ant policy=expert output=ant.mp4

Writes ``output`` (mp4). Headless rendering needs Debian's ``libosmesa6``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torchrl.envs import Transform

import pemirl_envs
from pemirl_envs.rendering import render, write_video
from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.measuring.rollouts import environment, of_demonstrations, of_tasks
from pemirl_lab.measuring.scores import load_test_demonstrations
from pemirl_lab.runs.places import run_file
from pemirl_lab.runs.run_folder import say
from pemirl_lab.runs.settings import Settings
from pemirl_trl.configuration import CHECKED, Count
from pemirl_trl.evaluation import whole_episodes
from pemirl_trl.pretrained import load_model
from pemirl_trl.sharing import load_policy

Filmed = tuple[Callable[[TensorDictBase], TensorDictBase], Transform, int]
"""A policy, what resets to its tasks, and their number."""


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own.

    Attributes:
        run: the folder of a run, where the next two come from one.
        model_file, policy_file: what is filmed.
        policy: ``adapted``, of the run, or ``expert``, the task's, under the test dynamics.
        tasks: how many.
        every: control steps between two frames.
        camera, width, height: of the pictures.
        output: the film.
    """

    run: str
    model_file: str
    policy_file: str
    policy: Literal["adapted", "expert"]
    tasks: Count
    every: Count
    camera: str
    width: Count
    height: Count
    output: str


@torch.no_grad()
def run(settings: Settings, own: Own) -> None:
    """Roll the policy out, one episode after the other, and film it."""
    policy, transform, count = {"adapted": adapted, "expert": expert}[own.policy](settings, own)
    name = settings.test_environment
    task = pemirl_envs.get_task(name)
    env = environment(name, count, transform, seed=settings.seed, threads=settings.threads)
    states = []

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        states.append(env.base_env.physics_state())
        return policy(tensordict)

    whole_episodes(env, act, task.horizon)
    film = torch.stack(states[:: own.every], 1).flatten(0, 1)  # [tasks * frames, n_state]
    frames = render(task, film, width=own.width, height=own.height, camera=own.camera)
    write_video(own.output, frames, fps=1 / (task.control_timestep * own.every))
    say(f"{count} episodes -> {own.output}")


def adapted(settings: Settings, own: Own) -> Filmed:
    """An adapted policy, with the contexts of a few unseen demonstrations."""
    model = load_model(run_file(own.model_file, "quickstart or meta_train"))
    file = run_file(own.policy_file, "quickstart or adapt_reward")
    policy = load_policy(file, model)
    demonstrations = load_test_demonstrations(settings)
    few = demonstrations[_spread(len(demonstrations), own.tasks)]
    return policy, of_demonstrations(model, few, 1), len(few)


def expert(settings: Settings, own: Own) -> Filmed:
    """The expert under the test dynamics, with a few unseen tasks."""
    tasks = pemirl_envs.task_parameters(settings.test_environment, "test")
    few = tasks[_spread(len(tasks), own.tasks)]
    return load_expert(settings.expert_file(settings.test_environment)), of_tasks(few, 1), len(few)


def _spread(available: int, wanted: int) -> torch.Tensor:
    return torch.linspace(0, available - 1, min(available, wanted)).round().long()
