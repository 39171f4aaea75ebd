"""Observations of several keys as one vector."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase, Transform


class JoinObservations(Transform):
    """Writes ``observation`` ``[..., S]``: some of what an environment observes, in a row.

    Each entry is flattened and cast to torch's default dtype. The entries themselves are left out
    of what the environment gives; what is not named stays as it is.

    Args:
        keys: of the environment's observation, in this order; ``"arm.angle"`` is the entry
            ``angle`` of the entry ``arm``.
        env: that gives them.

    Raises:
        ValueError: no key, the same one twice, or one that the environment does not give; the
            message lists those that it gives.
    """

    def __init__(self, keys: Sequence[str], env: EnvBase) -> None:
        super().__init__(in_keys=[], out_keys=["observation"])
        there = {
            ".".join(key) if isinstance(key, tuple) else key: key
            for key in env.observation_spec.keys(include_nested=True, leaves_only=True)
        }
        unknown = [key for key in keys if key not in there]
        if unknown or not keys or len(set(keys)) != len(keys):
            raise ValueError(
                f"got observation_keys={[*keys]}; expected different ones of {sorted(there)}, "
                "which the environment observes"
            )
        self.keys: list[NestedKey] = [there[key] for key in keys]

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        size = next_tensordict.batch_dims
        values = [_vector(next_tensordict.get(key), size) for key in self.keys]
        return next_tensordict.exclude(*self.keys).set("observation", torch.cat(values, -1))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """The environment's, with one vector in the place of the entries."""
        if not isinstance(observation_spec, Composite):
            raise TypeError(f"got {type(observation_spec).__name__}; expected a Composite")
        batch = observation_spec.shape
        size = sum(observation_spec[key].shape[len(batch) :].numel() for key in self.keys)
        joined = observation_spec.clone()
        for key in self.keys:
            del joined[key]
        joined["observation"] = Unbounded(
            (*batch, size), dtype=torch.get_default_dtype(), device=observation_spec.device
        )
        return joined


def _vector(value: Tensor, batch_dims: int) -> Tensor:
    return value.to(torch.get_default_dtype()).reshape(*value.shape[:batch_dims], -1)
