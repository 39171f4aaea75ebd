"""Gymnasium's Reacher-v5, which does not see its goal, and an arm that was built otherwise."""

from __future__ import annotations

import math

import mujoco
import torch
from gymnasium_task import Expert, GymnasiumTask, uniform
from tensordict import TensorDictBase
from torch import Generator, Tensor

from pemirl_envs import Component, Fields, Parameters, State, TaskEnv

UPPER_ARM, FOREARM = 0.1, 0.11  # m, from joint to joint and to the fingertip
STRETCH = 1.5  # of the changed arm's forearm
ELBOW_LIMIT = 3.0  # rad
GEAR = 200.0  # N m of an action of 1
STIFFNESS, DAMPING = 100.0, 20.0  # N m / rad, N m s / rad; inertias are about 1, by the armature
NOISE = 0.05  # of the demonstrated actions, which are bounded by 1
DEMONSTRATIONS = 400
SETTINGS = ("preset=contrastive", "task_space=[6,7]")  # an arm moves what the task is about
# By name of the result; the weight of actions is Reacher's, and r(s, m) is in units of its own.
ADAPTATIONS = {"reacher": {}, "reacher_action_cost": {"action_cost": 1.0}}


class Reacher(GymnasiumTask):
    """A fingertip is to be held at a goal: ``goal`` ``[N, 2]`` (m), anywhere in a disk of 0.2 m.

    Args:
        changed: the forearm is half as long again, and the elbow's motor turns the other way.
    """

    xml = "reacher.xml"
    horizon = 50
    n_sub_steps = 2
    stage = mujoco.mjtStage.mjSTAGE_POS
    observation_components = (
        Component("cosines", "1", 2),
        Component("sines", "1", 2),
        Component("joint_velocities", "rad/s", 2),
        Component("fingertip", "m", 2),
    )
    task_space = ("fingertip",)

    def __init__(self, changed: bool = False) -> None:
        self.changed = changed
        bound = torch.full((2,), 0.2)
        self.parameter_bounds = {"goal": (-bound, bound)}

    def build_spec(self) -> mujoco.MjSpec:
        """Gymnasium's arm, or the changed one."""
        spec = super().build_spec()
        if self.changed:
            spec.geom("link1").fromto[3] *= STRETCH
            spec.body("fingertip").pos[0] *= STRETCH
            spec.actuators[1].gear[0] *= -1
        return spec

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Goals, uniform in the disk, as in Gymnasium."""
        radius, angle = torch.rand(2, n, dtype=torch.float64, generator=generator)
        angle = math.tau * angle
        goal = 0.2 * radius.sqrt().unsqueeze(-1) * torch.stack([angle.cos(), angle.sin()], -1)
        return {"goal": goal.float()}

    def initial_state(self, parameters: Parameters, generator: Generator) -> State:
        """Joints within 0.1 rad and 0.005 rad/s of a stretched arm at rest, as in Gymnasium."""
        goal = parameters["goal"].double()
        angles = uniform(len(goal), 2, bound=0.1, generator=generator)
        speeds = uniform(len(goal), 2, bound=0.005, generator=generator)
        return {
            "qpos": torch.cat([angles, goal], -1),
            "qvel": torch.cat([speeds, torch.zeros_like(goal)], -1),
        }

    def observe(self, fields: Fields) -> Tensor:
        """Cosines, sines and velocities of the joints, and where the fingertip is."""
        angles = fields("qpos")[:, :2]
        fingertip = fields("xpos")[:, FINGERTIP, :2]
        parts = [angles.cos(), angles.sin(), fields("qvel")[:, :2], fingertip]
        return torch.cat(parts, -1).float()

    @staticmethod
    def terms(observation: Tensor, action: Tensor, value: Tensor) -> dict[str, Tensor]:
        """Minus the distance to the goal, and minus the squared action, each ``[..., 1]``."""
        distance = (observation[..., 6:] - value).norm(dim=-1, keepdim=True)
        return {"distance": -distance, "actions": -action.square().sum(-1, keepdim=True)}


FINGERTIP = Reacher().model.body("fingertip").id


def make_env(num_envs: int, seed: int) -> TaskEnv:
    """Gymnasium's arm."""
    return TaskEnv(Reacher(), num_envs, seed=seed)


def make_changed_env(num_envs: int, seed: int) -> TaskEnv:
    """The changed arm."""
    return TaskEnv(Reacher(changed=True), num_envs, seed=seed)


def experts(seed: int) -> tuple[Expert, Expert]:
    """Controllers that know the goal, of Gymnasium's arm and the changed one; none is drawn."""
    return controller(changed=False), controller(changed=True)


def controller(changed: bool) -> Expert:
    """A spring and a damper towards the angles that put this arm's fingertip at the goal."""
    forearm, sign = (STRETCH * FOREARM, -1.0) if changed else (FOREARM, 1.0)
    motor = torch.tensor([1.0, sign]) / GEAR

    def act(td: TensorDictBase) -> TensorDictBase:
        observation, goal = td["observation"], td["task", "goal"]
        angles = torch.atan2(observation[..., 2:4], observation[..., :2])
        offset = joint_angles(goal, forearm) - angles
        # Of the shoulder, which may turn all the way; the elbow must not cross its limits.
        offset[..., 0] = torch.atan2(offset[..., 0].sin(), offset[..., 0].cos())
        torque = STIFFNESS * offset - (DAMPING - 1.0) * observation[..., 4:6]  # joints damp by 1
        return td.set("action", (motor * torque).clamp(-1, 1))

    return act


def joint_angles(goal: Tensor, forearm: float) -> Tensor:
    """Shoulder and elbow ``[..., 2]`` with the fingertip at a goal, or as near as it can be."""
    x, y = goal.unbind(-1)
    distance = goal.norm(dim=-1)
    cosine = (distance**2 - UPPER_ARM**2 - forearm**2) / (2 * UPPER_ARM * forearm)
    elbow = cosine.clamp(-1, 1).acos().clamp(max=ELBOW_LIMIT)
    beside = torch.atan2(forearm * elbow.sin(), UPPER_ARM + forearm * elbow.cos())
    return torch.stack([torch.atan2(y, x) - beside, elbow], -1)
