"""Seeds of every kind that users bring, as the 32 bits that a torch generator on the CPU keeps."""

from __future__ import annotations

import copy
import hashlib
import operator
import secrets
from collections.abc import Sequence
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Seed = SupportsIndex | Sequence[int] | NDArray[np.integer] | Tensor | np.random.RandomState | None
"""An integer of any type, a sequence of them, a ``RandomState``, or None: a new one each time."""

_BITS = 32


def generator_seed(seed: Seed) -> int:
    """The seed in [0, 2³²) for a ``torch.Generator`` on the CPU, of whose seeds 32 bits count.

    Integers below 2³² are their own; a ``RandomState`` that one of them has just made is that
    integer; a sequence of one integer is that integer, as in NumPy. All others are hashed, so that
    different seeds give different streams, but for chance. A ``RandomState`` is not drawn from.

    >>> generator_seed(np.int64(7)), generator_seed([7]), generator_seed(np.random.RandomState(7))
    (7, 7, 7)

    Raises:
        TypeError: it is none of these, such as a bool, a float or a string.
        ValueError: it is negative, or an empty sequence.
    """
    if seed is None:
        return secrets.randbits(_BITS)
    if isinstance(seed, np.random.RandomState):
        return _of_random_state(seed)
    integers = _integers(seed)
    if not integers or min(integers) < 0:
        raise ValueError(f"the seed is {seed!r}; expected integers that are not negative")
    if len(integers) == 1 and integers[0] < 2**_BITS:
        return integers[0]
    return _hashed(repr(integers).encode())


def _integers(seed: Any) -> list[int]:
    values = np.asarray(seed, dtype=object)
    flat = [seed] if values.ndim == 0 else values.tolist()
    try:
        if values.ndim > 1 or any(isinstance(value, bool | np.bool) for value in flat):
            raise TypeError("a table, or a truth value")
        return [operator.index(value) for value in flat]
    except TypeError as error:
        raise TypeError(
            f"the seed is {seed!r}, of type {type(seed).__name__}; expected an integer, a sequence "
            "of integers, a numpy.random.RandomState, or None"
        ) from error


def _of_random_state(state: np.random.RandomState) -> int:
    words = state.get_state(legacy=False)["state"].get("key")  # of a Mersenne Twister alone
    if words is not None:
        first = int(words[0])  # right after the seeding with an integer: that integer
        if _stream(np.random.RandomState(first)) == _stream(state):
            return first
    return _hashed(_stream(state))


def _stream(state: np.random.RandomState) -> bytes:
    return copy.deepcopy(state).bytes(32)


def _hashed(content: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(content, digest_size=_BITS // 8).digest(), "big")
