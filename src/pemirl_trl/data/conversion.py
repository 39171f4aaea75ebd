"""Anyone's arrays become float32 tensors, and nothing is lost in silence."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from tensordict import TensorDict
from torch import Tensor

from pemirl_trl.data.validation import check_finite

__all__ = ["narrowed", "plain_tensor", "task_batch", "wide_tensor"]

_EXACT_INTEGERS = 2**53  # the integers up to it are exact in float64
_NARROW = (torch.bool, torch.int8, torch.uint8, torch.int16)
_NARROW_FLOATS = (torch.float32, torch.float16, torch.bfloat16)

MAX_ERROR_PER_DEVIATION = 1e-2
"""Root mean square of the rounding error, relative to a feature's deviation."""
MAX_ERROR_PER_STEP = 0.1
"""The same, relative to what a feature changes by from one step to the next."""
LEAST_VARIATION = 1e-6
"""A feature of no more deviation, absolutely or relative to its magnitude, counts as constant: it
is the noise of a simulator at rest (:class:`pemirl_trl.modules.Standardize` holds it so too)."""


def _real_array(value: ArrayLike, what: str) -> NDArray[Any]:
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{what} is not an array ({error}); expected real numbers") from error
    if array.dtype.kind not in "biuf" or (np.ma.isMaskedArray(value) and np.ma.is_masked(value)):
        masked = " with masked entries" if array.dtype.kind in "biuf" else ""
        raise ValueError(f"{what} is an array of {array.dtype}{masked}; expected real numbers")
    return array


def plain_tensor(value: ArrayLike | Tensor, what: str) -> Tensor:
    """``value`` as a real tensor of its own dtype, in memory of its own or without a graph.

    Raises:
        ValueError: text, objects, complex numbers, masked entries, or rows of unequal length.
    """
    if isinstance(value, Tensor):
        if value.is_complex():
            raise ValueError(f"{what} is a tensor of {value.dtype}; expected real numbers")
        return value.detach()
    array = _real_array(value, what)
    kind = np.float64 if array.dtype.itemsize > 8 else array.dtype.newbyteorder("=")
    return torch.from_numpy(np.array(array, dtype=kind, order="C"))


def task_batch(values: dict[str, Tensor], episodes: int) -> TensorDict:
    """Task parameters by name as one batch ``[episodes]``.

    Raises:
        ValueError: one of them has not one entry per episode.
    """
    odd = {name: tuple(v.shape) for name, v in values.items() if v.shape[:1] != (episodes,)}
    if odd:
        raise ValueError(
            f"task entries have shapes {odd}; expected [{episodes}, ...], one entry per episode"
        )
    return TensorDict(values, batch_size=[episodes])


def wide_tensor(value: ArrayLike | Tensor, what: str) -> Tensor:
    """``value`` in float32 where that is exact by its dtype, else in float64, without a graph.

    Raises:
        ValueError: as :func:`plain_tensor`; or integers too large for float64.
    """
    tensor = plain_tensor(value, what)
    if tensor.dtype in _NARROW or tensor.dtype in _NARROW_FLOATS:
        return tensor.float()
    wide = tensor.double()
    if not tensor.is_floating_point() and bool((wide.abs() > _EXACT_INTEGERS).any()):
        raise ValueError(
            f"{what} holds integers beyond 2^53, which no float tells apart; subtract an offset "
            "first, such as its first value"
        )
    return wide


def narrowed(name: str, values: Tensor) -> Tensor:
    """Episodes ``[M, L, F]`` in float32, whose variation is still there.

    Raises:
        ValueError: values that float32 cannot hold, or a feature whose rounding errors are a
            relevant share of what it varies by: then an offset hides its variation.
    """
    rounded = values.float()
    check_finite(name, rounded)
    if values.dtype == torch.float64 and values.numel():
        for feature in _lost_features(values, rounded)[:1]:
            raise ValueError(_loss(name, feature, values[..., feature], rounded[..., feature]))
    return rounded


def _lost_features(values: Tensor, rounded: Tensor) -> list[int]:
    """The features of ``[M, L, F]`` that lose a relevant share of their variation."""
    squares = (values - rounded.double()).square()
    deviation = values.flatten(0, 1).std(0, correction=0)  # [F]
    varies = deviation > LEAST_VARIATION * values.abs().amax((0, 1)).clamp(max=1.0)
    lost = squares.mean((0, 1)).sqrt() > MAX_ERROR_PER_DEVIATION * deviation
    if values.shape[1] > 1:
        steps = values.diff(dim=1).square().mean(1)  # [M, F]
        moves = steps > 0.01 * steps.mean(0)  # of an episode at rest only noise is lost
        lost |= (moves & (squares.mean(1).sqrt() > MAX_ERROR_PER_STEP * steps.sqrt())).any(0)
    return (varies & lost).nonzero().flatten().tolist()


def _loss(name: str, feature: int, values: Tensor, rounded: Tensor) -> str:
    before, after = (
        torch.tensor([len(episode.unique()) for episode in x]) for x in (values, rounded)
    )
    episode = int((before - after).argmax())
    return (
        f"{name} feature {feature} loses its precision in float32: in episode {episode}, its "
        f"{before[episode]} distinct values become {after[episode]}. Subtract an offset first, "
        f"such as its mean {float(values.mean()):.9g}, or choose another unit; or cast to float32 "
        "yourself, if that is meant"
    )
