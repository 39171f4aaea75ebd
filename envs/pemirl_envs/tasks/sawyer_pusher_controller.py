"""Controllers by hand for Sawyer Pusher, which learned nothing: what its returns are worth."""

from __future__ import annotations

import torch
from torch import Tensor

from pemirl_envs.tasks.quantities import Controller, Parameters

_BESIDE_THE_WALL = 0.06  # m, by how much the mug passes its left end
_BEFORE_THE_WALL, _BEYOND_THE_WALL = 0.035, 0.08  # m, from its centre line


def push_to_goal(observation: Tensor, parameters: Parameters) -> Tensor:
    """Pushes the mug straight to its goal, float32 ``[N, 9]`` -> ``[N, 3]``."""
    return _push_towards(observation, parameters["goal"])


def push_around_wall(left_end: float, y: float) -> Controller:
    """Pushes the mug past the left end of a wall that lies across its way, and then to its goal.

    Args:
        left_end: x of the wall's left end, metres.
        y: of the wall's centre line, metres.
    """
    x = left_end - _BESIDE_THE_WALL

    def controller(observation: Tensor, parameters: Parameters) -> Tensor:
        mug = observation[:, 3:5]
        before = observation.new_tensor((x, y - _BEFORE_THE_WALL))
        beyond = observation.new_tensor((x, y + _BEYOND_THE_WALL))
        left_of_the_wall = mug[:, :1] < before[0] + 0.03
        target = torch.where(left_of_the_wall, beyond, before)
        past_the_wall = mug[:, 1:] > beyond[1] - 0.04
        return _push_towards(observation, torch.where(past_the_wall, parameters["goal"], target))

    return controller


def mirrored(controller: Controller) -> Controller:
    """The same in the mirror at x = 0."""

    def reflected(observation: Tensor, parameters: Parameters) -> Tensor:
        sign = observation.new_tensor((-1.0, 1.0, 1.0))
        goal = parameters["goal"] * sign[:2]
        return sign * controller(observation * sign.repeat(3), {**parameters, "goal": goal})

    return reflected


def _push_towards(observation: Tensor, target: Tensor) -> Tensor:
    """Gets behind the mug and pushes it to the target ``[N, 2]``; within the action's bounds."""
    hand, mug = observation[:, :2], observation[:, 3:5]
    offset = target - mug
    distance = offset.norm(dim=-1, keepdim=True)
    ahead = offset / distance.clamp(min=1e-6)
    aside = torch.stack([-ahead[:, 1], ahead[:, 0]], -1)
    along = ((hand - mug) * ahead).sum(-1, keepdim=True)
    lateral = ((hand - mug) * aside).sum(-1, keepdim=True)
    beside = mug + 0.075 * torch.where(lateral >= 0, aside, -aside) - 0.05 * ahead
    in_the_way = (along > -0.04) & (lateral.abs() < 0.06)
    approach = 0.5 * (torch.where(in_the_way, beside, mug - 0.07 * ahead) - hand)
    push = 0.01 * ahead * (distance / 0.05).clamp(max=1) - 0.5 * lateral * aside
    retreat = -0.2 * (hand - mug + 0.055 * ahead)
    aligned = (along < -0.03) & (lateral.abs() < 0.02)
    move = torch.where(aligned, torch.where(distance < 0.01, retreat, push), approach)
    move = move / (move.norm(dim=-1, keepdim=True) / 0.01).clamp(min=1)
    step = torch.cat([move, 0.035 - observation[:, 2:3]], -1) / 0.01  # actions are in centimetres
    return step.clamp(-1, 1)
