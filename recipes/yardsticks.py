"""Controllers that learned nothing, by environment: what returns on our scale are worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

AROUND_THE_WALL = ((-0.16, 0.665), (-0.16, 0.78))
"""Metres: where the mug is to be before the wall's left end, and then beyond it."""

Controller = Callable[[Tensor, Tensor], Tensor]
"""(observation ``[N, 9]``, goal ``[N, 2]``) -> action ``[N, 3]`` of the Sawyer pusher."""


def push_towards(observation: Tensor, target: Tensor) -> Tensor:
    """Gets behind the mug and pushes it to the target ``[N, 2]``."""
    hand, mug = observation[:, :2], observation[:, 3:5]
    offset = target - mug
    distance = offset.norm(dim=-1, keepdim=True)
    ahead = offset / distance.clamp(min=1e-6)
    aside = torch.stack([-ahead[:, 1], ahead[:, 0]], -1)
    along = ((hand - mug) * ahead).sum(-1, keepdim=True)
    lateral = ((hand - mug) * aside).sum(-1, keepdim=True)
    beside = mug + 0.075 * torch.where(lateral >= 0, 1.0, -1.0) * aside - 0.05 * ahead
    in_the_way = (along > -0.04) & (lateral.abs() < 0.06)
    approach = 0.5 * (torch.where(in_the_way, beside, mug - 0.07 * ahead) - hand)
    push = 0.01 * ahead * (distance / 0.05).clamp(max=1) - 0.5 * lateral * aside
    retreat = -0.2 * (hand - mug + 0.055 * ahead)
    aligned = (along < -0.03) & (lateral.abs() < 0.02)
    move = torch.where(aligned, torch.where(distance < 0.01, retreat, push), approach)
    move = move / (move.norm(dim=-1, keepdim=True) / 0.01).clamp(min=1)
    return torch.cat([move, 0.035 - observation[:, 2:3]], -1) / 0.01


def push_around_the_wall(observation: Tensor, goal: Tensor) -> Tensor:
    """Pushes the mug past the wall's left end, and then to its goal."""
    mug = observation[:, 3:5]
    before, beyond = torch.tensor(AROUND_THE_WALL)
    left_of_the_wall = mug[:, :1] < before[0] + 0.03
    target = torch.where(left_of_the_wall, beyond, before)
    return push_towards(observation, torch.where(mug[:, 1:] > beyond[1] - 0.04, goal, target))


def _policy(controller: Controller) -> TensorDictModule:
    return TensorDictModule(
        lambda observation, goal: controller(observation, goal).clamp(-1, 1),
        in_keys=["observation", ("task", "goal")],
        out_keys=["action"],
    )


YARDSTICKS: Mapping[str, TensorDictModule] = {
    "sawyer_pusher/normal": _policy(push_towards),
    "sawyer_pusher/shift": _policy(push_around_the_wall),
}
