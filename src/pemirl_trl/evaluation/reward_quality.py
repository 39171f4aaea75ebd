"""Does the learned reward point at the goal? Ground truth enters here, and nowhere in learning."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl.evaluation.reward_distance import (
    RewardFunction,
    evaluate_reward,
    with_transitions,
)
from pemirl_trl.evaluation.statistics import spearman

__all__ = [
    "Bounds",
    "argmax_error",
    "distance_to_goal",
    "map_of_reward",
    "position_grid",
    "reward_on_grid",
    "spearman_with_distance",
]

Bounds = tuple[tuple[float, float], tuple[float, float]]
"""``((x_low, x_high), (y_low, y_high))`` in metres."""


def position_grid(bounds: Bounds, resolution: tuple[int, int]) -> Tensor:
    """Centres of the cells of a grid over ``bounds``.

    Args:
        bounds: the rectangle, in metres.
        resolution: H cells along y, W along x.

    Returns:
        ``[H, W, 2]`` positions (x, y); row 0 has the lowest y.

    Raises:
        ValueError: an empty rectangle or resolution.
    """
    (x_low, x_high), (y_low, y_high) = bounds
    height, width = resolution
    if min(height, width) < 1 or x_low >= x_high or y_low >= y_high:
        raise ValueError(
            f"got bounds {bounds} and resolution {resolution}; "
            "expected ((x_low, x_high), (y_low, y_high)) with low < high, and (H, W) >= (1, 1)"
        )
    x = x_low + (x_high - x_low) * (torch.arange(width) + 0.5) / width
    y = y_low + (y_high - y_low) * (torch.arange(height) + 0.5) / height
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)


@torch.no_grad()
def reward_on_grid(
    reward: Callable[[TensorDictBase], TensorDictBase],
    context: Tensor,
    positions: Tensor,
    *,
    observe: Callable[[Tensor], Tensor] | None = None,
    reward_key: NestedKey = "learned_reward",
    observation_key: NestedKey = "observation",
    context_key: NestedKey = "context",
) -> Tensor:
    """Evaluate the learned reward r(s, m) at every position, for every context at once.

    Args:
        reward: reads ``observation [..., S]`` and ``context [..., D]``, writes
            ``learned_reward [..., 1]``.
        context: ``[C, D]``.
        positions: ``[H, W, 2]``, see :func:`position_grid`.
        observe: positions ``[H, W, 2]`` to observations ``[H, W, S]``; None where they are equal.
        reward_key: what ``reward`` writes.
        observation_key: where it reads observations.
        context_key: where it reads contexts.

    Returns:
        ``[C, H, W]``.

    Raises:
        ValueError: wrong shapes, or ``reward`` did not write one number per state.
    """
    if context.ndim != 2 or positions.ndim != 3 or positions.shape[-1] != 2:
        raise ValueError(
            f"got context {tuple(context.shape)} and positions {tuple(positions.shape)}; "
            "expected [C, D] and [H, W, 2]"
        )
    observation = positions.to(context) if observe is None else observe(positions.to(context))
    shape = (context.shape[0], *positions.shape[:2])  # [C, H, W]
    batch = TensorDict(batch_size=shape, device=context.device)
    batch[observation_key] = observation.expand(*shape, -1)
    batch[context_key] = context[:, None, None].expand(*shape, -1)
    # Flat, as in training: a module may be written for one batch dimension.
    value = reward(batch.reshape(-1)).get(reward_key, None)
    if value is None or value.numel() != batch.numel():
        got = "nothing" if value is None else f"shape {tuple(value.shape)}"
        raise ValueError(
            f"the reward module wrote {got} under {reward_key!r}; expected [{batch.numel()}, 1]"
        )
    return value.reshape(shape)


def map_of_reward(
    reward: RewardFunction,
    like: TensorDictBase,
    positions: Tensor,
    *,
    observe: Callable[[Tensor], Tensor] | None = None,
) -> Tensor:
    """Evaluate any reward of transitions at rest at every position: s' = s, action zero.

    Of a shaped reward f = r + gamma h(s') - h(s) that is r(s) - (1 - gamma) h(s).

    Args:
        reward: of transitions ``[C, B]``.
        like: transitions ``[C, ...]`` of the same tasks, which give what else ``reward`` reads.
        positions: ``[H, W, 2]``, see :func:`position_grid`.
        observe: positions ``[H, W, 2]`` to observations ``[H, W, S]``; None where they are equal.

    Returns:
        ``[C, H, W]`` float64.
    """
    observation = (positions if observe is None else observe(positions)).flatten(0, 1)
    states = observation.to(like["observation"]).expand(like.batch_size[0], -1, -1)
    action = like["action"][:, :1].expand(-1, states.shape[1], -1)
    batch = with_transitions(like, states, torch.zeros_like(action), states)
    return evaluate_reward(reward, batch).unflatten(1, positions.shape[:2])


def distance_to_goal(positions: Tensor, goals: Tensor) -> Tensor:
    """Distance of every position ``[H, W, 2]`` to every goal ``[C, 2]``: ``[C, H, W]``, metres."""
    return (positions - goals[:, None, None].to(positions)).norm(dim=-1)


def spearman_with_distance(reward: Tensor, positions: Tensor, goals: Tensor) -> Tensor:
    """Rank correlation of the learned reward with minus the distance to the goal.

    Args:
        reward: ``[C, H, W]``; positions: ``[H, W, 2]``; goals: ``[C, 2]`` in metres.

    Returns:
        ``[C]`` in [-1, 1]; 1 where the reward falls with every step away from the goal.
    """
    distance = distance_to_goal(positions, goals)
    return spearman(reward.flatten(1), -distance.flatten(1).to(reward.device))


def argmax_error(reward: Tensor, positions: Tensor, goals: Tensor) -> Tensor:
    """Distance from the place of highest learned reward to the goal.

    Args:
        reward: ``[C, H, W]``; positions: ``[H, W, 2]``; goals: ``[C, 2]`` in metres.

    Returns:
        ``[C]`` metres; half a cell's diagonal is the resolution's own error.
    """
    best = positions.flatten(0, 1)[reward.flatten(1).argmax(1).to(positions.device)]  # [C, 2]
    return (best - goals.to(best)).norm(dim=-1)
