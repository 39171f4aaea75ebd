"""Point-Maze: a particle is pushed around a barrier to a goal.

Source: PEMIRL, "Point-Maze" and "Point-Maze-Shift" (section 4 and the appendices), and the authors'
public code, ermongroup/MetaIRL ``inverse_rl/envs/point_maze_env.py``. Three things differ from that
code. The observation is (x, y): the authors append a constant z and the goal. The control cost is
that of the control that is applied, the clipped one. The 60 x 100 cm stochastic maze, of which the
paper gives the size and the noise alone, stretches the 60 x 60 cm one along y.
"""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Callable
from types import MappingProxyType
from typing import Any, Literal

import mujoco
import numpy as np
import torch
from torch import Generator, Tensor

from pemirl_envs.simulation import Fields, State
from pemirl_envs.tasks.base import Layout, Parameters, Task
from pemirl_envs.tasks.quantities import Component, final_distance_to_goal

_XML = pathlib.Path(__file__).with_suffix(".xml")

_WIDTH = 0.6  # m; the walls' centre lines span x in [-0.1, 0.6]
_TALL = 1.0  # m, height of the stochastic maze (paper, appendix C)
_RIGHT_BARRIER = (0.2, 0.6)  # m, x of the ends of the shifted barrier
_GOAL_GAP = 0.1  # m, from the row of the goals to the north wall's centre line
_TRANSITION_NOISE = 0.01  # m, standard deviation per axis and control step (paper, appendix C)
_CONTROL_COST = 0.001  # 1 / N^2
_POSITION_OFFSET = 0.05  # m, half-width of the uniform initial offset
_VELOCITY_OFFSET = 0.01  # m/s

_GOAL_MEANS = (0.1, 0.3, 0.5)  # m, components of the distribution of test goals
_GOAL_STD = 0.05  # m
_GOAL_RANGE = (0.0, 0.6)  # m, to which that distribution is truncated

_TASK_SETS = {
    "train_100": (100, 2019_100),
    "validation": (15, 2019_015),
    "test": (30, 2019_030),
    "confirm": (30, 2026_030),
}  # number of goals, seed


class PointMaze(Task):
    """A maze with one barrier.

    Splits:
        ``train``: 13 goals, x in {0, 0.04, ..., 0.48} (the authors' code).
        ``train_100``: 100 goals drawn once from ``continuous`` (the paper's number of tasks).
        ``validation``: 15 other goals, to choose settings on.
        ``test``: 30 other goals, to report on.
        ``confirm``: 30 more, to be looked at once; all three drawn once from ``continuous``.
        ``continuous``: x ~ N(mean, 0.05) with the mean one of 0.1, 0.3, 0.5, truncated to [0, 0.6];
        a new draw for each episode.
        ``uniform``: x ~ U(0, 0.6); a new draw for each episode. Covers every other split. The
        particle's centre reaches x = 0.55: a goal beyond stays up to 5 cm away.

    Args:
        barrier: the side on which the barrier is attached; the gap is on the other one.
        height: metres between the bottom of the start region and the top wall's centre line.
        noise: standard deviation, in metres, of the Gaussian added to each coordinate after each
            control step.
    """

    horizon = 100
    n_sub_steps = 5
    observation_components = (Component("position", "m", 2),)
    task_space = ("position",)
    outcomes = MappingProxyType(
        {"final_distance_m": final_distance_to_goal(observation_components, "position")}
    )
    planar = True
    splits = ("train", "train_100", "validation", "test", "confirm", "continuous", "uniform")

    def __init__(
        self,
        barrier: Literal["left", "right"] = "left",
        height: float = _WIDTH,
        noise: float = 0.0,
    ) -> None:
        self._barrier = barrier
        self._height = height
        self._noise = noise
        plan = self.layout()
        self._start = torch.tensor(plan.start, dtype=torch.float64)
        low, high = torch.tensor((plan.low, plan.high), dtype=torch.float32)
        self.parameter_bounds = {"goal": (low, high)}

    def build_spec(self) -> mujoco.MjSpec:
        """The model file, with its walls stretched and its barrier moved to this variant."""
        spec = mujoco.MjSpec.from_file(str(_XML))
        stretch = self._height / _WIDTH
        for wall in _walls(spec):
            ends_y = wall.fromto[[1, 4]]
            wall.fromto[[1, 4]] = np.where(ends_y > 0, ends_y * stretch, ends_y)
        if self._barrier == "right":
            spec.geom("barrier").fromto[[0, 3]] = _RIGHT_BARRIER
        camera = spec.camera("top")
        camera.pos[1:] = ((self._height - _GOAL_GAP) / 2, camera.pos[2] * stretch)
        return spec

    def layout(self) -> Layout:
        """The walls, the barrier (named ``barrier``) and the start, as the model has them."""
        spec = self.build_spec()
        ends = {wall.name: wall.fromto.tolist() for wall in _walls(spec)}
        start = spec.body("particle").pos
        return Layout(
            walls={name: ((x0, y0), (x1, y1)) for name, (x0, y0, _, x1, y1, _) in ends.items()},
            wall_radius=float(spec.geom("barrier").size[0]),
            start=(float(start[0]), float(start[1])),
            low=(ends["south"][0], ends["south"][1]),
            high=(ends["north"][3], ends["north"][4]),
        )

    def task_set(self, split: str) -> dict[str, Tensor]:
        """The goals of a finite split, float32 ``[K, 2]``; see the class for the splits."""
        if split == "train":
            return self._goals(0.04 * torch.arange(13, dtype=torch.float64))
        if split in _TASK_SETS:
            size, seed = _TASK_SETS[split]
            return self._goals(_draw_goal_x(size, Generator().manual_seed(seed)))
        legal = ("train", *_TASK_SETS)
        raise ValueError(f"{split!r} is not a finite split; expected one of {legal}")

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Draws ``n`` goals, float32 ``[N, 2]``; see the class for the splits."""
        if split == "continuous":
            return self._goals(_draw_goal_x(n, generator))
        if split == "uniform":
            low, high = _GOAL_RANGE
            x = torch.rand(n, dtype=torch.float64, generator=generator)
            return self._goals(low + (high - low) * x)
        if split not in self.splits:
            raise ValueError(f"unknown split {split!r}; expected one of {self.splits}")
        goals = self.task_set(split)["goal"]
        return {"goal": goals[torch.randint(len(goals), (n,), generator=generator)]}

    def _goals(self, x: Tensor) -> dict[str, Tensor]:
        y = torch.full_like(x, self._height - _GOAL_GAP)
        return {"goal": torch.stack([x, y], -1).float()}

    def initial_state(self, parameters: Parameters, generator: Generator) -> State:
        """Position within 5 cm of the start on each axis, velocity within 1 cm/s; both uniform."""
        goal = parameters["goal"].double()
        unit = torch.rand(2, len(goal), 2, dtype=torch.float64, generator=generator) * 2 - 1
        return {
            "qpos": _POSITION_OFFSET * unit[0],
            "qvel": _VELOCITY_OFFSET * unit[1],
            "mocap_pos": torch.nn.functional.pad(goal, (0, 1))[:, None],  # [N, 1, 3]
        }

    def observe(self, fields: Fields) -> Tensor:
        """The particle's position (x, y) in metres, float32 ``[N, 2]``."""
        return self._position(fields).float()

    def reward(self, fields: Fields, action: Tensor, parameters: Parameters) -> Tensor:
        """r(s, a) = -|p - g|_2 - 0.001 |a|_2^2, float32 ``[N]``; p, g in metres, a in newtons."""
        offset = self._position(fields) - parameters["goal"]
        distance = offset.square().sum(-1).sqrt()
        return (-distance - _CONTROL_COST * action.double().square().sum(-1)).float()

    def observed_fields(self, observation: Tensor) -> State:
        """The position of the slides, measured from the start, float64 ``[N, 2]``."""
        return {"qpos": observation.double() - self._start}

    def disturb(self, fields: Fields, generator: Generator) -> State:
        """Gaussian transition noise on the position (the stochastic variants alone)."""
        if not self._noise:
            return {}
        qpos = fields("qpos")
        noise = torch.randn(qpos.shape, dtype=qpos.dtype, generator=generator)
        return {"qpos": qpos + self._noise * noise}

    def _position(self, fields: Fields) -> Tensor:
        return self._start + fields("qpos")  # the slides' axes are x and y


def _walls(spec: mujoco.MjSpec) -> list[Any]:
    return [geom for geom in spec.geoms if geom.classname.name == "wall"]


def _draw_goal_x(n: int, generator: Generator) -> Tensor:
    """Draws x from the truncated mixture of the test goals by its inverse CDF, float64 ``[n]``.

    The authors draw mean and offset again until x is legal, so a mean's share is proportional to
    the mass that its component has inside the range.
    """
    means = torch.tensor(_GOAL_MEANS, dtype=torch.float64)
    cdf_low, cdf_high = (torch.special.ndtr((end - means) / _GOAL_STD) for end in _GOAL_RANGE)
    shares = (cdf_high - cdf_low).cumsum(0)
    which, u = torch.rand(2, n, dtype=torch.float64, generator=generator)
    k = torch.searchsorted(shares, which * shares[-1], right=True)
    quantile = cdf_low[k] + u * (cdf_high[k] - cdf_low[k])
    x = means[k] + _GOAL_STD * torch.special.ndtri(quantile)
    return x.clamp(*_GOAL_RANGE)  # rounding


VARIANTS: dict[str, Callable[[], PointMaze]] = {
    "left": PointMaze,
    "right": functools.partial(PointMaze, "right"),
    "stochastic": functools.partial(PointMaze, "right", _TALL, _TRANSITION_NOISE),
    "stochastic_left": functools.partial(PointMaze, "left", _TALL, _TRANSITION_NOISE),
}
