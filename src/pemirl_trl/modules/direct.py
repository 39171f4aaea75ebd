"""A TensorDict module with little overhead."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import nn

from pemirl_trl.modules.reading import missing_key


class DirectModule(TensorDictModuleBase):
    """Calls a network on its in-keys and sets its outputs, tensors all of them.

    Unlike ``tensordict.nn.TensorDictModule`` it does not inspect each output for what it could be
    converted from, which for small networks costs more than the network: a third of a policy's time
    when it is stepped with a simulator.

    Args:
        net: takes the in-keys' values in order and returns a tuple of tensors.
        in_keys, out_keys: of the tensordict.
        optional: in-keys that may be missing; the network gets None for them.
        reader: who reads, in errors.

    Raises:
        MissingKeyError: a batch lacks an in-key.
    """

    def __init__(
        self,
        net: nn.Module,
        in_keys: Sequence[NestedKey],
        out_keys: Sequence[NestedKey],
        optional: Sequence[NestedKey] = (),
        reader: str = "DirectModule",
    ) -> None:
        super().__init__()
        self.net, self.in_keys, self.out_keys = net, list(in_keys), list(out_keys)
        self.optional, self.reader = tuple(optional), reader

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the outputs into ``tensordict``."""
        try:
            inputs = [
                tensordict.get(key, None) if key in self.optional else tensordict[key]
                for key in self.in_keys
            ]
        except KeyError:
            present, needed = tensordict.keys(True), set(self.in_keys) - set(self.optional)
            absent = next(key for key in self.in_keys if key in needed and key not in present)
            raise missing_key(tensordict, absent, self.reader) from None
        outputs = self.net(*inputs)
        for key, value in zip(self.out_keys, outputs, strict=True):
            tensordict.set(key, value)
        return tensordict
