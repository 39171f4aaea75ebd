"""A TensorDict module with little overhead."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import nn


class DirectModule(TensorDictModuleBase):
    """Calls a network on its in-keys and sets its outputs, tensors all of them.

    Unlike ``tensordict.nn.TensorDictModule`` it does not inspect each output for what it could be
    converted from, which for small networks costs more than the network: a third of a policy's time
    when it is stepped with a simulator.

    Args:
        net: takes the in-keys' values in order and returns a tuple of tensors.
        in_keys, out_keys: of the tensordict.
        optional: in-keys that may be missing; the network gets None for them.
    """

    def __init__(
        self,
        net: nn.Module,
        in_keys: Sequence[NestedKey],
        out_keys: Sequence[NestedKey],
        optional: Sequence[NestedKey] = (),
    ) -> None:
        super().__init__()
        self.net, self.in_keys, self.out_keys = net, list(in_keys), list(out_keys)
        self.optional = tuple(optional)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the outputs into ``tensordict``."""
        inputs = [
            tensordict.get(key, None) if key in self.optional else tensordict[key]
            for key in self.in_keys
        ]
        outputs = self.net(*inputs)
        for key, value in zip(self.out_keys, outputs, strict=True):
            tensordict.set(key, value)
        return tensordict
