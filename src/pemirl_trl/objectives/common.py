"""What TorchRL asks of every loss that has no value estimator of its own."""

from __future__ import annotations

from typing import Any

from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.objectives import LossModule


class KeyedLoss(LossModule):
    """A :class:`~torchrl.objectives.LossModule` whose input keys follow ``set_keys``.

    A subclass says which keys it reads in :meth:`_input_keys`.
    """

    def __init__(self) -> None:
        self._in_keys: list[NestedKey] | None = None
        super().__init__()

    def _input_keys(self) -> list[NestedKey]:
        raise TypeError(f"{type(self).__name__} does not say which keys it reads")

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        self._in_keys = None

    @property
    def in_keys(self) -> list[NestedKey]:
        """Keys that ``forward`` reads, in the order of its keyword call."""
        if self._in_keys is None:
            self._in_keys = self._input_keys()
        return self._in_keys

    @in_keys.setter
    def in_keys(self, values: list[NestedKey]) -> None:
        self._in_keys = values


def per_rollout(context: Tensor, time_dim: int) -> Tensor:
    """Contexts ``[N, T, D]`` that are constant along T, as ``[N, D]``; ``[N, D]`` passes."""
    return context.select(time_dim, 0) if context.ndim > time_dim + 1 else context
