"""What TorchRL asks of every loss that has no value estimator of its own."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.objectives import LossModule

from pemirl_trl.modules.reading import read, trajectories_of


class KeyedLoss(LossModule):
    """A :class:`~torchrl.objectives.LossModule` whose input keys follow ``set_keys``.

    A subclass says which keys it reads in :meth:`_input_keys`. A data set that has a method
    ``trajectories`` is taken for these.
    """

    def __init__(self) -> None:
        self._in_keys: list[NestedKey] | None = None
        super().__init__()

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Compute the loss of a tensordict, of a data set or of keyword arguments."""
        return super().__call__(*map(trajectories_of, args), **kwargs)

    def _read(self, tensordict: TensorDictBase, role: str) -> Tensor:
        key = getattr(self.tensor_keys, role)
        return read(tensordict, key, type(self).__name__, role)

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
        """Take other keys, as TorchRL's dispatch does."""
        self._in_keys = values


def require_time(values: Tensor, owner: str, name: str) -> None:
    """Raise unless ``values`` are those of whole rollouts, ``[N, T, F]``.

    Args:
        values: of a batch.
        owner: who needs the time, the name of a class.
        name: of the values.

    Raises:
        ValueError: they have another number of dimensions.
    """
    if values.ndim != 3:
        raise ValueError(
            f"{owner} takes whole rollouts [N, T], with {name} [N, T, ...] of three dimensions, "
            f"got {name} {list(values.shape)}: give the rollouts as collected, not flattened"
        )


def per_rollout(context: Tensor, time_dim: int) -> Tensor:
    """Return contexts ``[N, T, D]`` that are constant along T as ``[N, D]``; ``[N, D]`` passes."""
    return context.select(time_dim, 0) if context.ndim > time_dim + 1 else context
