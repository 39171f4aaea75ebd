"""Observations of several entries and actions that are choices, as the vectors of a data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from pemirl_trl.data.conversion import wide_tensor

__all__ = ["action_vectors", "is_one_hot", "observation_vectors"]


def is_one_hot(action: Tensor) -> bool:
    """Whether every action ``[M, T, A]`` is one of A > 1 choices; a row may end in zeros."""
    chosen = action.sum(-1)
    return bool(
        action.shape[-1] > 1
        and ((action == 0) | (action == 1)).all()
        and (chosen <= 1).all()
        and (chosen[:, 0] == 1).all()
        and (chosen.diff(dim=1) <= 0).all()  # padding stands at the end
    )


def action_vectors(action: Any, choices: int | None, what: str, *, leading: int = 1) -> Tensor:
    """Actions as real vectors: ``[T, A]`` as they are, choices ``[T]`` or ``[T, 1]`` as one-hot.

    Args:
        action: of one episode, or of several.
        choices: n, of discrete actions given as integers from 0 to n - 1; None: they are vectors.
        what: names them in errors.
        leading: dimensions in front of what one action is: 1 of an episode, 2 of several.

    Raises:
        ValueError: something that is no real numbers; with ``choices`` also what is neither one-hot
            of that size nor such integers.
    """
    values = wide_tensor(action, what)
    if choices is None:
        return values
    vectors = values.ndim == leading + 1
    if vectors and values.shape[-1] == choices and is_one_hot(values.reshape(1, -1, choices)):
        return values
    index = values.squeeze(-1) if vectors and values.shape[-1] == 1 else values
    legal = (index == index.round()) & (index >= 0) & (index < choices)
    if index.ndim != leading or not bool(legal.all()):
        raise ValueError(
            f"{what} of shape {list(values.shape)} is not of {choices} discrete actions; expected "
            f"integers from 0 to {choices - 1}, one a step, or one-hot vectors of {choices}"
        )
    return torch.nn.functional.one_hot(index.long(), choices).float()


def observation_vectors(observation: Any, keys: Sequence[str] | None, what: str) -> Tensor:
    """Observations of one episode as real vectors ``[T + 1, S]``.

    Args:
        observation: an array ``[T + 1, S]``, or a mapping of such arrays (of any number of
            dimensions, each flattened), which may hold mappings.
        keys: which entries of a mapping, in this order; ``"arm.angle"`` is the entry ``angle`` of
            the entry ``arm``.
        what: names them in errors.

    Raises:
        ValueError: a mapping and no keys, or keys and no mapping; a key that is not there; or
            something that is no real numbers.
    """
    if not isinstance(observation, Mapping):
        if keys is not None:
            raise ValueError(
                f"{what} is one array; got observation_keys={[*keys]} to choose from it"
            )
        return wide_tensor(observation, what)
    entries = dict(_leaves(observation))
    unknown = [key for key in keys or () if key not in entries]
    if unknown or not keys or len(set(keys)) != len(keys):
        raise ValueError(
            f"{what} has the entries {sorted(entries)}; expected observation_keys=[...], different "
            f"ones of these, got {None if keys is None else [*keys]}"
        )
    parts = [wide_tensor(entries[key], f"{what}, entry {key}") for key in keys]
    lengths = {len(part) if part.ndim else 0 for part in parts}
    if len(lengths) > 1:
        raise ValueError(f"{what} has entries of lengths {sorted(lengths)}; expected T + 1 of each")
    wide = torch.float64 if any(part.dtype == torch.float64 for part in parts) else torch.float32
    return torch.cat([part.reshape(len(part), -1).to(wide) for part in parts], -1)


def _leaves(mapping: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for name, value in mapping.items():
        if isinstance(value, Mapping):
            found += _leaves(value, f"{prefix}{name}.")
        else:
            found.append((f"{prefix}{name}", value))
    return found
