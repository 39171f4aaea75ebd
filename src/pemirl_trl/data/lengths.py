"""Demonstrations of different lengths: padding, and what goes on after an end.

An episode that *ended* (terminated: the goal was reached, the robot fell) is continued to T in an
absorbing state; of one that was merely *cut* (truncated: the recording stopped) nobody knows how it
went on, and its padding is read by nobody.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import pad

__all__ = ["check_lengths", "lengthened", "pad_episodes", "steps_after", "with_indicator"]


def pad_episodes(values: Sequence[Tensor], *, repeat: bool) -> Tensor:
    """Stack ``[L_i, F]`` to ``[M, max L, F]``; padding repeats the last row, or is zero."""
    longest = max(map(len, values))
    return torch.stack([_padded(value, longest, repeat) for value in values])


def lengthened(values: Tensor, longest: int, *, repeat: bool) -> Tensor:
    """``[M, L, F]`` padded to ``[M, longest, F]``, as :func:`pad_episodes` does."""
    return torch.stack([_padded(value, longest, repeat) for value in values])


def _padded(value: Tensor, longest: int, repeat: bool) -> Tensor:
    rest = longest - len(value)
    if not repeat:
        return pad(value, (0, 0, 0, rest))
    return torch.cat([value, value[-1:].expand(rest, -1)])


def steps_after(length: Tensor, horizon: int) -> Tensor:
    """Which of T steps begin after the end of episodes of ``length`` ``[M]`` steps: ``[M, T]``."""
    return torch.arange(horizon, device=length.device) >= length.unsqueeze(-1)


def with_indicator(observation: Tensor, length: Tensor, ended: Tensor) -> Tensor:
    """Observations ``[M, T+1, S]`` with one component more, 1 from the end on of what ended.

    The observation itself stays that of the end, which padding repeats.
    """
    after = steps_after(length, observation.shape[1]) & ended.unsqueeze(-1)
    return torch.cat([observation, after.unsqueeze(-1).to(observation.dtype)], -1)


def check_lengths(length: Tensor | None, terminated: Tensor | None, shape: Sequence[int]) -> None:
    """Raise ValueError unless both are ``[M]``, integers from 1 to T and booleans.

    Args:
        length, terminated: what is checked, or None.
        shape: ``(M, T)``.
    """
    episodes, horizon = shape
    for name, value, dtype in (
        ("length", length, torch.int64),
        ("terminated", terminated, torch.bool),
    ):
        if value is None:
            continue
        if not isinstance(value, Tensor) or value.dtype != dtype or value.shape != (episodes,):
            got = (
                f"{tuple(value.shape)} {value.dtype}"
                if isinstance(value, Tensor)
                else f"a {type(value).__name__}"
            )
            raise ValueError(f"{name} is {got}; expected [{episodes}] {dtype}, one per episode")
    if length is not None and not bool(((length >= 1) & (length <= horizon)).all()):
        raise ValueError(
            f"length goes from {int(length.min())} to {int(length.max())}; expected 1 to {horizon} "
            "steps, the actions that there are"
        )
