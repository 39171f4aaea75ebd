"""Ant: a four-legged body walks forward or backward; with two of its legs disabled, too.

Source: PEMIRL, "Ant" and "Disabled-Ant" (section 4 and the appendices), whose authors published no
code for it, and the code of the paper that they take the disabled ant from, justinjfu/inverse_rl
``inverse_rl/envs/ant_env.py`` (CustomAnt-v0, DisabledAnt-v0). What differs from that code, and what
is our choice, is in ``docs/ant.md``.
"""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Literal

import mujoco
import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from pemirl_envs.simulation import Fields, State
from pemirl_envs.tasks.base import Parameters, Task
from pemirl_envs.tasks.quantities import Component, component_slice

_XML = pathlib.Path(__file__).with_suffix(".xml")

_LEGS = (1, 2, 3, 4)
_FRONT_LEGS = (3, 4)  # the eyes are on their side
_DISABLED_LENGTH = 0.5  # of a disabled thigh and shin, relative to a healthy one
_DISABLED_GEAR = 1.0  # N m; healthy motors have 30
_CONTROL_COST = 0.01
_UPSIDE_DOWN_COST = 1.0
_POSITION_OFFSET = 0.1  # m, rad; half-width of the uniform initial offset of each coordinate
_VELOCITY_STD = 0.1  # m/s, rad/s

_DIRECTIONS = ((1.0,), (-1.0,))  # forward, backward
_POSITIONS, _VELOCITIES = 13, 14  # how many of each an observation holds


_COMPONENTS = (
    Component("torso_height", "m"),
    Component("torso_orientation", "1", 4),  # a quaternion (w, x, y, z)
    Component("joint_angles", "rad", 8),
    Component("torso_velocity_xy", "m/s", 2),  # world frame
    Component("torso_velocity_z", "m/s"),
    Component("torso_angular_velocity", "rad/s", 3),  # torso frame
    Component("joint_velocities", "rad/s", 8),
)


def speed_along_direction(observation: Tensor, parameters: Parameters) -> Tensor:
    """The torso's mean speed along the direction, m/s, of observations ``[N, T, 27]``; ``[N]``."""
    x = component_slice(_COMPONENTS, "torso_velocity_xy").start
    return observation[..., x].mean(-1) * parameters["direction"][:, 0]


class Ant(Task):
    """An ant that is to walk along +x or along -x, as far as it can, without being flipped.

    The task parameter is ``direction``, float32 ``[N, 1]``: 1 (forward) or -1 (backward).

    Splits: ``train``, ``validation``, ``test`` and ``confirm`` are the same two directions; there
    are no others.

    Args:
        disabled: legs (1 to 4) whose thighs and shins are half as long, and whose motors have a
            thirtieth of their strength; True: the two front ones. The motors keep their order, so
            that a policy can be carried over.
        integrator: MuJoCo's. ``RK4`` is that of the original, at under a third of the speed.

    Raises:
        ValueError: there is no such leg.
    """

    horizon = 500
    n_sub_steps = 5
    observation_components = _COMPONENTS
    task_space = ("torso_velocity_xy",)
    outcomes = MappingProxyType({"speed_m_per_s": speed_along_direction})
    default_split = "train"
    splits = ("train", "validation", "test", "confirm")

    def __init__(
        self,
        *,
        disabled: bool | Sequence[int] = False,
        integrator: Literal["Euler", "RK4"] = "Euler",
    ) -> None:
        legs = _FRONT_LEGS if disabled is True else disabled or ()
        if unknown := sorted(set(legs) - set(_LEGS)):
            raise ValueError(f"there is no leg {unknown}; legs are {list(_LEGS)}")
        self._disabled_legs = tuple(legs)
        self._integrator = integrator
        forward, backward = torch.tensor(_DIRECTIONS)
        self.parameter_bounds = {"direction": (backward, forward)}

    def build_spec(self) -> mujoco.MjSpec:
        """The model file, with this variant's integrator and legs."""
        spec = mujoco.MjSpec.from_file(str(_XML))
        if self._integrator == "RK4":
            spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        for leg in self._disabled_legs:
            _disable(spec, leg)
        return spec

    def task_set(self, split: str) -> dict[str, Tensor]:
        """Both directions, forward first, float32 ``[2, 1]``: every split is this set."""
        if split not in self.splits:
            raise ValueError(f"{split!r} is not a finite split; expected one of {self.splits}")
        return {"direction": torch.tensor(_DIRECTIONS)}

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Draws ``n`` directions, float32 ``[N, 1]``, each with probability 1/2."""
        if split not in self.splits:
            raise ValueError(f"unknown split {split!r}; expected one of {self.splits}")
        directions = torch.tensor(_DIRECTIONS)
        return {"direction": directions[torch.randint(2, (n,), generator=generator)]}

    def validate_parameters(
        self, parameters: Parameters, n: int, mask: Tensor | None = None
    ) -> None:
        """Checks that every direction (of ``mask``, bool ``[n]``) is 1 or -1.

        Raises:
            ValueError: one is not, or the shape is not ``[n, 1]``.
        """
        super().validate_parameters(parameters, n, mask)
        direction = parameters["direction"][:, 0]
        illegal = direction.abs() != 1
        if mask is not None:
            illegal &= mask
        if illegal.any():
            bad = illegal.nonzero().flatten().tolist()[:5]
            raise ValueError(
                f"direction of simulation(s) {bad} is {direction[bad].tolist()}; "
                "legal values are 1 (forward) and -1 (backward)"
            )

    def initial_state(self, parameters: Parameters, generator: Generator) -> State:
        """The default pose (torso at 0.75 m, joints at 0) with random offsets.

        Each coordinate of ``qpos`` is offset by U(-0.1, 0.1), and the quaternion then normalised;
        each of ``qvel`` is drawn from N(0, 0.1²).
        """
        n, model = len(parameters["direction"]), self.model
        unit = torch.rand(n, model.nq, dtype=torch.float64, generator=generator) * 2 - 1
        qpos = torch.from_numpy(model.qpos0) + _POSITION_OFFSET * unit
        qpos[:, 3:7] /= qpos[:, 3:7].norm(dim=-1, keepdim=True)
        qvel = torch.randn(n, model.nv, dtype=torch.float64, generator=generator)
        return {"qpos": qpos, "qvel": _VELOCITY_STD * qvel}

    def observe(self, fields: Fields) -> Tensor:
        """All of the state but x and y, float32 ``[N, 27]``.

        Torso height (m) and orientation (w, x, y, z), 8 joint angles (rad), torso velocity (m/s,
        world frame) and angular velocity (rad/s, torso frame), 8 joint velocities (rad/s).
        """
        return torch.cat([fields("qpos")[:, 2:], fields("qvel")], -1).float()

    def reward(self, fields: Fields, action: Tensor, parameters: Parameters) -> Tensor:
        """r(s, a) = d v_x - 0.01 |a|_2^2 - 1[upside down], float32 ``[N]``.

        ``d`` is the direction, ``v_x`` the torso's velocity in m/s. PEMIRL, appendix on
        environments: "moving as far as possible forward or backward without being flipped".
        """
        qpos, qvel = fields("qpos"), fields("qvel")
        progress = parameters["direction"][:, 0] * qvel[:, 0]
        control_cost = _CONTROL_COST * action.double().square().sum(-1)
        return (progress - control_cost - _UPSIDE_DOWN_COST * (upright(qpos) < 0)).float()

    def observed_fields(self, observation: Tensor) -> State:
        """Positions [N, 15] and velocities [N, 14], float64; of x and y, which are not seen, 0."""
        qpos, qvel = observation.double().split([_POSITIONS, _VELOCITIES], -1)
        return {"qpos": pad(qpos, (2, 0)), "qvel": qvel}


def upright(qpos: Tensor) -> Tensor:
    """The z component of the torso's up axis: 1 on its feet, -1 on its back; ``[N, 15]`` -> [N].

    R_zz = 1 - 2 (q_x² + q_y²), of the unit quaternion (q_w, q_x, q_y, q_z) in ``qpos[:, 3:7]``.
    """
    return 1 - 2 * qpos[:, 4:6].square().sum(-1)


def _disable(spec: mujoco.MjSpec, leg: int) -> None:
    """Shortens thigh and shin of one leg, weakens its motors, and colours it."""
    for part in ("thigh", "shin"):
        spec.geom(f"{part}_{leg}").fromto *= _DISABLED_LENGTH
    spec.body(f"shin_{leg}").pos *= _DISABLED_LENGTH
    for joint in ("hip", "ankle"):
        spec.actuator(f"{joint}_{leg}").gear[0] = _DISABLED_GEAR
    for part in ("leg", "thigh", "shin"):
        spec.geom(f"{part}_{leg}").material = "disabled"


VARIANTS: dict[str, Callable[[], Ant]] = {
    "normal": Ant,
    "disabled": functools.partial(Ant, disabled=True),
    "disabled_left": functools.partial(Ant, disabled=(2, 3)),
    "disabled_diagonal": functools.partial(Ant, disabled=(1, 3)),
    "disabled_one": functools.partial(Ant, disabled=(2,)),
    "normal_rk4": functools.partial(Ant, integrator="RK4"),
    "disabled_rk4": functools.partial(Ant, disabled=True, integrator="RK4"),
}
