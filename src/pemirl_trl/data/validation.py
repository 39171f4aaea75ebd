"""What makes a set of demonstrations well formed; every complaint names the episodes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pemirl_trl.data.lengths import check_lengths, pad_episodes

__all__ = ["check_demonstrations", "check_finite", "episode_names", "stack_episodes"]


def episode_names(bad: Tensor | Sequence[int]) -> str:
    """``episode 3`` or ``episodes 0, 3, 7 ... (12 in all)``."""
    indices = [int(i) for i in bad]
    shown = ", ".join(map(str, indices[:5]))
    more = f" ... ({len(indices)} in all)" if len(indices) > 5 else ""
    return f"episode{'s' if len(indices) > 1 else ''} {shown}{more}"


def check_finite(name: str, value: Tensor) -> None:
    """Raise ValueError, naming the episodes, unless all of ``value`` ``[M, ...]`` is finite."""
    bad = (~torch.isfinite(value)).reshape(len(value), -1).any(1).nonzero().flatten()
    if bad.numel():
        raise ValueError(
            f"{name} is NaN or infinite in {episode_names(bad)}; expected finite values"
        )


def _check_task(task: TensorDictBase, episodes: int) -> None:
    if tuple(task.batch_size) != (episodes,):
        raise ValueError(
            f"task has batch_size {list(task.batch_size)}; "
            f"expected [{episodes}], one entry per episode"
        )
    for key, value in task.items(include_nested=True, leaves_only=True):
        names = (key,) if isinstance(key, str) else key
        # "." and "/" join nested names in the file formats.
        if not isinstance(value, Tensor) or any(c in name for name in names for c in "./"):
            raise ValueError(
                f"task entry {key!r} is a {type(value).__name__}; expected a tensor under names "
                "without '.' and '/'"
            )
        check_finite(f"task entry {key!r}", value)


def check_demonstrations(
    observation: Tensor,
    action: Tensor,
    task: TensorDictBase | None,
    length: Tensor | None = None,
    terminated: Tensor | None = None,
) -> None:
    """Raise ValueError unless the three obey the schema of :class:`DemonstrationDataset`.

    Args:
        observation: ``[M, T+1, S]`` float32.
        action: ``[M, T, A]`` float32.
        task: ground truth with batch_size ``[M]``, or None.
        length, terminated: ``[M]``, int64 and boolean, or None.
    """
    for name, value, shape in (("observation", observation, "T+1, S"), ("action", action, "T, A")):
        if not isinstance(value, Tensor):
            raise ValueError(
                f"{name} is a {type(value).__name__}; expected a tensor [M, {shape}] "
                "torch.float32 (from_episodes takes arrays)"
            )
        if value.ndim != 3 or value.dtype != torch.float32:
            raise ValueError(
                f"{name} is {tuple(value.shape)} {value.dtype}; expected [M, {shape}] torch.float32"
            )
    episodes, horizon = action.shape[:2]
    if observation.shape[:2] != (episodes, horizon + 1):
        raise ValueError(
            f"{observation.shape[0]} episodes of {observation.shape[1]} observations, "
            f"{episodes} of {horizon} actions; expected as many episodes, and T+1 observations "
            "for T actions: the last one is what the last action led to"
        )
    if 0 in (episodes, horizon, observation.shape[2]):  # actions of no dimension: not recorded
        raise ValueError(
            f"observation {tuple(observation.shape)} and action {tuple(action.shape)} are empty; "
            "expected at least one episode, step and dimension"
        )
    check_finite("observation", observation)
    check_finite("action", action)
    check_lengths(length, terminated, (episodes, horizon))
    if task is not None:
        _check_task(task, episodes)


def stack_episodes(
    episodes: Sequence[tuple[Tensor, Tensor]],
) -> tuple[Tensor, Tensor, Tensor]:
    """Stack ``(observation [L+1, S], action [L, A])`` pairs to ``[M, T+1, S]`` and ``[M, T, A]``.

    The first episode says what S and A are, the longest T. Shorter ones are padded: with their last
    observation, and with actions of 0. The third is the lengths L, ``[M]``.

    Raises:
        ValueError: no episodes, an off-by-one or mixed dimensions.
    """
    if not episodes:
        raise ValueError("got no episodes; expected a list of (observation, action) pairs")
    flat = [i for i, pair in enumerate(episodes) if any(x.ndim != 2 for x in pair)]
    if flat:
        shapes = [tuple(x.shape) for x in episodes[flat[0]]]
        raise ValueError(
            f"{episode_names(flat)}: got observation and action of shapes {shapes[0]} and "
            f"{shapes[1]}; expected [T+1, S] and [T, A] (for integers [T] that are choices, "
            "discrete_actions says how many there are)"
        )
    uneven = [i for i, (o, a) in enumerate(episodes) if len(o) != len(a) + 1]
    if uneven:
        observation, action = episodes[uneven[0]]
        raise ValueError(
            f"{episode_names(uneven)}: {len(observation)} observations for {len(action)} actions; "
            "expected T+1 for T, the last one being what the last action led to"
        )
    sizes = [x.shape[1] for x in episodes[0]]
    odd = [i for i, pair in enumerate(episodes) if [x.shape[1] for x in pair] != sizes]
    if odd:
        got = [x.shape[1] for x in episodes[odd[0]]]
        raise ValueError(
            f"{episode_names(odd)}: observation and action have dimension {got[0]} and {got[1]}; "
            f"expected {sizes[0]} and {sizes[1]} as in episode 0"
        )
    observations, actions = zip(*episodes, strict=True)
    length = torch.tensor([len(action) for action in actions])
    observation = pad_episodes(observations, repeat=True)
    return observation, pad_episodes(actions, repeat=False), length
