"""A device that this machine does not have: tensors on it hold values, and refuse what a GPU would.

``torch.device("meta")`` stands for it. While :class:`PretendDevice` is on, a tensor that is moved
there keeps its values on the CPU inside a :class:`OnDevice`. Operations on such tensors give what
the CPU gives, bit for bit, and raise where CUDA's would: a tensor of the CPU among them, unless it
is a scalar, an index or the other side of a copy. Random numbers drawn on the device are an error
here, since a run's draws are to be the CPU's.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

DEVICE = torch.device("meta")
COPIES = ("copy_", "_to_copy")
INDEXED = ("index", "index_put_", "index_put", "_index_put_impl_", "_unsafe_index")


class OnDevice(Tensor):
    """A tensor on the pretended device."""

    value: Tensor

    @staticmethod
    def __new__(cls, value: Tensor) -> OnDevice:
        return Tensor._make_wrapper_subclass(
            cls,
            value.shape,
            strides=value.stride(),
            storage_offset=value.storage_offset(),
            dtype=value.dtype,
            device=DEVICE,
        )

    def __init__(self, value: Tensor) -> None:
        self.value = value

    __torch_function__ = torch._C._disabled_torch_function_impl

    def __repr__(self, **_: Any) -> str:
        return f"OnDevice({self.value})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


class PretendDevice(TorchDispatchMode):
    """While it is on, ``tensor.to(DEVICE)`` and ``torch.zeros(..., device=DEVICE)`` work."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    name = func.overloadpacket.__name__
    tensors = [x for x in tree_flatten((args, kwargs))[0] if isinstance(x, Tensor)]
    here = [x for x in tensors if isinstance(x, OnDevice)]
    asked = kwargs.get("device")
    lands = bool(here) if asked is None else torch.device(asked) == DEVICE
    if here and name not in COPIES:
        _refuse_mixture(name, tensors)
    if (here or lands) and torch.Tag.nondeterministic_seeded in func.tags:
        raise RuntimeError(f"{name}: a random number is drawn on the device")
    if asked is not None and lands:
        kwargs = {**kwargs, "device": torch.device("cpu")}
    if name == "copy_":
        lands = isinstance(args[0], OnDevice)
    plain_args, plain_kwargs = tree_map(_value, (args, kwargs))
    result = func(*plain_args, **plain_kwargs)
    if name.endswith("_") and not name.startswith("_") and result is plain_args[0]:
        return args[0]  # in place
    if not lands:
        return result
    if name == "_to_copy" and any(result is x for x in tensors):
        result = result.clone()
    known = {id(x.value): x for x in here}
    return tree_map(
        lambda x: known.get(id(x)) or OnDevice(x) if isinstance(x, Tensor) else x, result
    )


def _value(x: Any) -> Any:
    return x.value if isinstance(x, OnDevice) else x


def _refuse_mixture(name: str, tensors: list[Tensor]) -> None:
    """Raise where CUDA would: tensors of the CPU may be scalars, or the indices of one of here."""
    if name in INDEXED and isinstance(tensors[0], OnDevice):
        return
    strangers = [list(x.shape) for x in tensors if not isinstance(x, OnDevice) and x.ndim > 0]
    if strangers:
        raise RuntimeError(f"{name} got tensors of the CPU {strangers} beside those of the device")
