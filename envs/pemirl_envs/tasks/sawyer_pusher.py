"""Sawyer Pusher: a Sawyer arm pushes a mug over a table to a goal.

Source: PEMIRL, "Sawyer Pusher" (section 4 and the appendices), which gives the reward and the
numbers of tasks; no public code of it is known. Control by a mocap body, its step, the box of the
hand and the start are those of multiworld's Sawyer environments (vitchyr/multiworld). All else is
this project's definition.
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
from pemirl_envs.tasks.quantities import Component, Controller, final_distance_to_goal
from pemirl_envs.tasks.sawyer_pusher_controller import mirrored, push_around_wall, push_to_goal

_XML = pathlib.Path(__file__).with_suffix(".xml")
_ARM_JOINTS = 7
_HAND_TARGET = 0  # index among the mocap bodies; the other one shows the goal

_ACTION_STEP = 0.01  # m, how far an action of 1 moves the hand's target
# m, low and high corner of the box of the hand's target
_HAND_BOX = torch.tensor([(-0.4, 0.4, 0.02), (0.4, 1.0, 0.3)], dtype=torch.float64)
# m, how far the target may be ahead of the hand on each axis; a free hand lags by less than 0.04
_LEASH = 0.05
_MUG_OFFSET = 0.02  # m, half-width of the uniform initial offset
_GOAL_HEIGHT = 0.001  # m, where the goal is drawn
_WALL_RIGHT, _WALL_Y = 0.45, 0.7  # m, its right end and its centre line
_WALL_THICKNESS, _WALL_HEIGHT = 0.02, 0.12  # m

_GOALS = GoalBox(low=(-0.3, 0.75), high=(0.3, 1.0), seed=2019_300)


class SawyerPusher(Task):
    """A hand that is moved in Cartesian steps, and a mug that slides with friction.

    Splits: those of :class:`~pemirl_envs.tasks.goals.GoalBox`; goals lie 15 to 50 cm beyond the
    mug's start.

    Args:
        wall: x in metres of the left end of a wall that runs across the way from there to the
            right, between the mug's start and the goals; ``None``: no wall.
        mirrored: whether wall and way round it are on the other side: x is then that of its right
            end, with the sign changed.
    """

    horizon = 200
    n_sub_steps = 5
    stage = mujoco.mjtStage.mjSTAGE_POS  # the hand's position follows from the joint angles
    observation_components = (
        Component("hand", "m", 3),
        Component("mug_xy", "m", 2),
        Component("mug_z", "m"),
        Component("mug_from_hand", "m", 3),
    )
    task_space = ("mug_xy",)  # where the mug stands, not how the hand holds it
    outcomes = MappingProxyType(
        {"final_distance_m": final_distance_to_goal(observation_components, "mug_xy")}
    )
    splits = GoalBox.splits

    def __init__(self, wall: float | None = None, *, mirrored: bool = False) -> None:
        self._wall, self._mirrored = wall, mirrored
        self.parameter_bounds = {"goal": _GOALS.bounds}

    @functools.cached_property
    def action_bounds(self) -> tuple[Tensor, Tensor]:
        """The box [-1, 1]^3: steps of the hand's target along x, y and z, in centimetres."""
        high = torch.ones(3, dtype=torch.float32)
        return -high, high

    def build_spec(self) -> mujoco.MjSpec:
        """The model file, and the wall of this variant."""
        spec = mujoco.MjSpec.from_file(str(_XML))
        if self._wall is not None:
            width = _WALL_RIGHT - self._wall
            middle = self._wall + width / 2
            spec.worldbody.add_geom(
                name="wall",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[-middle if self._mirrored else middle, _WALL_Y, _WALL_HEIGHT / 2],
                size=[width / 2, _WALL_THICKNESS / 2, _WALL_HEIGHT / 2],
                material="decoration",
            )
            for moving in ("mug", "handle", "stick"):
                spec.add_pair(spec.default, geomname1="wall", geomname2=moving)
        return spec

    @functools.cached_property
    def _start(self) -> tuple[Tensor, Tensor]:
        """The model's keyframe: positions [14], and the hand's target [3], on which it rests."""
        key = self.model.key("start")
        return torch.tensor(key.qpos), torch.tensor(key.mpos)[:3]

    def task_set(self, split: str) -> dict[str, Tensor]:
        """The goals of a finite split, float32 ``[K, 2]``."""
        return {"goal": _GOALS.task_set(split)}

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Draws ``n`` goals, float32 ``[N, 2]``."""
        return {"goal": _GOALS.sample(n, split, generator)}

    def initial_state(self, parameters: Parameters, generator: Generator) -> State:
        """The hand at rest in front of the mug, which stands within 2 cm of its place per axis."""
        goal = parameters["goal"].double()
        n = len(goal)
        qpos, hand = self._start
        unit = torch.rand(n, 2, dtype=torch.float64, generator=generator) * 2 - 1
        target = pad(goal, (0, 1), value=_GOAL_HEIGHT)
        return {
            "qpos": qpos + pad(_MUG_OFFSET * unit, (_ARM_JOINTS, 5)),
            "mocap_pos": torch.stack([hand.expand(n, 3), target], 1),  # [N, 2, 3]
        }

    def control(self, fields: Fields, action: Tensor) -> State:
        """Moves the hand's target by up to 1 cm on each axis, within the box of the hand.

        A hand that is blocked keeps its target near: otherwise the force upon what it squeezes
        would grow without bound.
        """
        low, high = _HAND_BOX
        mocap, hand = fields("mocap_pos").clone(), _hand(fields)
        moved = mocap[:, _HAND_TARGET] + _ACTION_STEP * action.double()
        moved = torch.clamp(moved, hand - _LEASH, hand + _LEASH)
        mocap[:, _HAND_TARGET] = torch.clamp(moved, low, high)
        return {"mocap_pos": mocap}

    def observe(self, fields: Fields) -> Tensor:
        """Hand, mug, and mug relative to hand, (x, y, z) each, metres, float32 ``[N, 9]``."""
        hand, mug = _hand(fields), _mug(fields)
        return torch.cat([hand, mug, mug - hand], -1).float()

    def reward(self, fields: Fields, action: Tensor, parameters: Parameters) -> Tensor:
        """r(s) = -|hand - mug|_2 - |mug_xy - g|_2, float32 ``[N]``; metres (paper, appendix)."""
        mug = _mug(fields)
        to_mug = vector_norm(_hand(fields) - mug, dim=-1)
        to_goal = vector_norm(mug[:, :2] - parameters["goal"], dim=-1)
        return (-to_mug - to_goal).float()

    def observed_fields(self, observation: Tensor) -> State:
        """Hand, float64 ``[N, 1, 3]``, and arm and mug, float64 ``[N, 10]``; the arm's are zero."""
        hand = observation[:, self.component_slice("hand")].double()
        mug = observation[:, self.components(["mug_xy", "mug_z"])].double()
        return {"site_xpos": hand[:, None], "qpos": pad(mug, (_ARM_JOINTS, 0))}

    def scripted_controller(self) -> Controller:
        """Gets behind the mug and pushes it to its goal, around the wall where there is one."""
        if self._wall is None:
            return push_to_goal
        around = push_around_wall(self._wall, _WALL_Y)
        return mirrored(around) if self._mirrored else around


def _hand(fields: Fields) -> Tensor:
    return fields("site_xpos")[:, 0]  # the model's first site: the tip of the stick


def _mug(fields: Fields) -> Tensor:
    return fields("qpos")[:, _ARM_JOINTS : _ARM_JOINTS + 3]  # the middle of the mug


VARIANTS: dict[str, Callable[[], Task]] = {
    "normal": SawyerPusher,
    "shift": functools.partial(SawyerPusher, wall=-0.1),
    "shift_mirrored": functools.partial(SawyerPusher, wall=-0.1, mirrored=True),
}
