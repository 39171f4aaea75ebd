"""Sweeper: a 7-joint arm with a blade sweeps a ball over a table to a goal.

Source: PEMIRL, "Sweeper" (section 4 and the appendices), which gives the reward and the numbers of
tasks; no public code of it is known. The arm is the pusher's of AIRL's public code
(justinjfu/inverse_rl), where an episode has 200 steps too. All else is this project's definition.
"""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Callable
from types import MappingProxyType

import mujoco
import torch
from torch import Generator, Tensor
from torch.linalg import vector_norm
from torch.nn.functional import pad

from pemirl_envs.simulation import Fields, State
from pemirl_envs.tasks.base import Parameters, Task
from pemirl_envs.tasks.goals import GoalBox
from pemirl_envs.tasks.quantities import Component, final_distance_to_goal

_XML = pathlib.Path(__file__).with_suffix(".xml")
_ARM_JOINTS = 7

_GOAL_HEIGHT = -0.324  # m, where the goal is drawn
_BALL_LOW, _BALL_HIGH = (-0.1, -0.1), (0.1, 0.0)  # m, the rectangle in which the ball starts
_VELOCITY_OFFSET = 0.005  # rad/s, half-width of the arm's uniform initial velocity (AIRL)

_GOALS = GoalBox(low=(-0.3, 0.05), high=(0.3, 0.25), seed=2019_200)


class Sweeper(Task):
    """A torque-controlled arm, seven joints, and a ball that slides with friction.

    Splits: those of :class:`~pemirl_envs.tasks.goals.GoalBox`; goals lie 5 to 45 cm beyond the
    ball's start, which does not depend on them.

    Args:
        blade: width of the blade between the centre lines of its lips, metres.
        damping: factor on the damping of the arm's joints.
    """

    horizon = 200
    n_sub_steps = 5
    stage = mujoco.mjtStage.mjSTAGE_POS  # the blade's position follows from the joint angles
    observation_components = (
        Component("joint_angles", "rad", _ARM_JOINTS),
        Component("joint_velocities", "rad/s", _ARM_JOINTS),
        Component("blade", "m", 3),
        Component("ball", "m", 3),
    )
    task_space = ("blade", "ball")
    outcomes = MappingProxyType(
        {"final_distance_m": final_distance_to_goal(observation_components, "ball")}
    )
    splits = GoalBox.splits

    def __init__(self, blade: float = 0.3, damping: float = 1.0) -> None:
        self._blade = blade
        self._damping = damping
        self.parameter_bounds = {"goal": _GOALS.bounds}

    def build_spec(self) -> mujoco.MjSpec:
        """The model file, with the blade's width and the joints' damping of this variant."""
        spec = mujoco.MjSpec.from_file(str(_XML))
        half = self._blade / 2
        spec.geom("blade").fromto[[1, 4]] = (-half, half)
        spec.geom("lip_right").fromto[[1, 4]] = -half
        spec.geom("lip_left").fromto[[1, 4]] = half
        for joint in spec.joints[:_ARM_JOINTS]:
            joint.damping *= self._damping
        return spec

    def task_set(self, split: str) -> dict[str, Tensor]:
        """The goals of a finite split, float32 ``[K, 2]``."""
        return {"goal": _GOALS.task_set(split)}

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Draws ``n`` goals, float32 ``[N, 2]``."""
        return {"goal": _GOALS.sample(n, split, generator)}

    def initial_state(self, parameters: Parameters, generator: Generator) -> State:
        """The arm stretched out along x, away from the ball; the ball uniform in its rectangle."""
        goal = parameters["goal"].double()
        n = len(goal)
        unit = torch.rand(n, _ARM_JOINTS + 2, dtype=torch.float64, generator=generator)
        low, high = torch.tensor((_BALL_LOW, _BALL_HIGH), dtype=torch.float64)
        ball = low + (high - low) * unit[:, _ARM_JOINTS:]
        velocity = _VELOCITY_OFFSET * (2 * unit[:, :_ARM_JOINTS] - 1)
        return {
            "qpos": pad(ball, (_ARM_JOINTS, 0)),
            "qvel": pad(velocity, (0, 2)),
            "mocap_pos": pad(goal, (0, 1), value=_GOAL_HEIGHT)[:, None],  # [N, 1, 3]
        }

    def observe(self, fields: Fields) -> Tensor:
        """Joint angles [7] (rad), joint velocities [7] (rad/s), blade [3] and ball [3] (m)."""
        angles = fields("qpos")[:, :_ARM_JOINTS]
        velocities = fields("qvel")[:, :_ARM_JOINTS]
        return torch.cat([angles, velocities, _blade_and_ball(fields).flatten(1)], -1).float()

    def reward(self, fields: Fields, action: Tensor, parameters: Parameters) -> Tensor:
        """r(s) = -|blade - ball|_2 - |ball_xy - g|_2, float32 ``[N]``; metres (paper, appendix)."""
        blade, ball = _blade_and_ball(fields).unbind(1)
        to_ball = vector_norm(blade - ball, dim=-1)
        to_goal = vector_norm(ball[:, :2] - parameters["goal"], dim=-1)
        return (-to_ball - to_goal).float()

    def observed_fields(self, observation: Tensor) -> State:
        """The positions of blade and ball, float64 ``[N, 2, 3]``."""
        sites = observation[:, self.task_space_indices()]
        return {"site_xpos": sites.double().view(-1, 2, 3)}


def _blade_and_ball(fields: Fields) -> Tensor:
    return fields("site_xpos")  # the model's two sites, [N, 2, 3]: middle of the blade, of the ball


VARIANTS: dict[str, Callable[[], Task]] = {
    "normal": Sweeper,
    "shift": functools.partial(Sweeper, blade=0.16, damping=3.0),
    "stiff": functools.partial(Sweeper, blade=0.22, damping=8.0),  # to confirm what "shift" says
    # Bodies to learn from: neither of the two above.
    "wide": functools.partial(Sweeper, blade=0.42, damping=2.0),
    "narrow": functools.partial(Sweeper, blade=0.24, damping=5.0),
    "limp": functools.partial(Sweeper, blade=0.36, damping=0.5),
}
