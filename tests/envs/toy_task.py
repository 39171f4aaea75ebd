"""The smallest task: a cart on a line, as a user's own file would define it."""

from pathlib import Path

import mujoco
import torch

from pemirl_envs import Component, Task

XML = Path(__file__).with_suffix(".xml")


class Cart(Task):
    """A cart is pushed to a position, from rest."""

    horizon = 10
    n_sub_steps = 2
    observation_components = (Component("position", "m"), Component("velocity", "m/s"))
    task_space = ("position",)
    splits = ("uniform",)
    default_split = "uniform"

    def __init__(self):
        self.parameter_bounds = {"aim": (torch.tensor([-1.0]), torch.tensor([1.0]))}

    def build_spec(self):
        return mujoco.MjSpec.from_file(str(XML))

    def sample_parameters(self, n, split, generator):
        return {"aim": torch.rand(n, 1, dtype=torch.float32, generator=generator) * 2 - 1}

    def task_set(self, split):
        raise ValueError(f"{split!r} is not a finite split; there is none")

    def initial_state(self, parameters, generator):
        n = len(parameters["aim"])
        return {"qpos": 0.1 * torch.randn(n, 1, dtype=torch.float64, generator=generator)}

    def observe(self, fields):
        return torch.cat([fields("qpos"), fields("qvel")], -1).float()

    def reward(self, fields, action, parameters):
        return -(fields("qpos") - parameters["aim"]).abs()[:, 0].float()
