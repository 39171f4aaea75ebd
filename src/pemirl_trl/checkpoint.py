"""Checkpoints of a training run, in files that nothing unpickles.

Tensors, keys, counters and optimiser options of a component go to one file of
:mod:`pemirl_trl.files`.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from torch import Tensor
from torchrl.checkpoint import Checkpoint, CheckpointAdapter, CheckpointRotation, GlobalRNGState

from pemirl_trl.files import read_tensors, write_tensors

__all__ = ["Stateful", "TrainingCheckpoint"]


@runtime_checkable
class Stateful(Protocol):
    """What can be checkpointed: a module, an optimiser, a buffer, a counter."""

    def state_dict(self) -> dict[str, Any]:
        """State made of tensors, mappings, lists, tuples, None, bool, int, float and str."""

    def load_state_dict(self, state_dict: Any, /) -> Any:
        """Take that state back."""


def _encode(value: Any, tensors: dict[str, Tensor]) -> Any:
    """Turn nested state into JSON, moving every tensor into ``tensors``."""
    match value:
        case Tensor():
            name = str(len(tensors))
            tensors[name] = value
            return {"tensor": name}
        case Mapping():  # pairs, since optimiser states have integer keys and JSON has none
            return {
                "mapping": [[_encode(k, tensors), _encode(v, tensors)] for k, v in value.items()]
            }
        case list():
            return {"list": [_encode(item, tensors) for item in value]}
        case tuple():
            return {"tuple": [_encode(item, tensors) for item in value]}
        case None | bool() | int() | float() | str():
            return value
        case _:
            raise ValueError(
                f"a state dict holds a {type(value).__name__}; a checkpoint takes tensors, "
                "mappings, lists, tuples, None, bool, int, float and str"
            )


def _decode(value: Any, tensors: Mapping[str, Tensor]) -> Any:
    """Invert :func:`_encode`."""
    match value:
        case {"tensor": name}:
            return tensors[name]
        case {"mapping": pairs}:
            return {_decode(k, tensors): _decode(v, tensors) for k, v in pairs}
        case {"list": items}:
            return [_decode(item, tensors) for item in items]
        case {"tuple": items}:
            return tuple(_decode(item, tensors) for item in items)
        case _:
            return value


class _SafetensorsAdapter(CheckpointAdapter):
    """Store a component's state dict as one safetensors file.

    TorchRL's own adapter reads memory-mapped folders, where tensordict 0.14 still unpickles a
    non-tensor field if one is present; a checkpoint from someone else could run code that way.
    """

    adapter_id = "pemirl_trl.safetensors"
    _file = "state.safetensors"

    def save(self, component: Stateful, path: Path, **_: Any) -> None:
        tensors: dict[str, Tensor] = {}
        state = _encode(component.state_dict(), tensors)
        write_tensors(path / self._file, tensors, kind="state", header={"state": state})

    def load(self, component: Stateful, path: Path, **_: Any) -> None:
        tensors, header = read_tensors(path / self._file, kind="state")
        component.load_state_dict(_decode(header["state"], tensors))


class TrainingCheckpoint:
    """The last ``keep`` checkpoints of one training run, on :mod:`torchrl.checkpoint`.

    Each checkpoint is a folder ``checkpoint-<iteration>``, staged beside its destination, renamed
    into place, and only then are older ones removed: a crash never costs the last good one.
    Python's, NumPy's and torch's global random states are stored too and restored last, so that a
    resumed run continues bit for bit.

    Args:
        directory: Folder of this run alone, with one writer.
        keep: How many checkpoints to keep, at least 1.
    """

    _RNG = "global_rng"

    def __init__(self, directory: str | Path, keep: int = 2) -> None:
        self._rotation = CheckpointRotation(directory, keep_last=keep)

    def _bind(self, components: Mapping[str, Stateful]) -> Checkpoint:
        checkpoint = Checkpoint()
        for name, component in components.items():
            if name == self._RNG or not isinstance(component, Stateful):
                raise ValueError(
                    f"component {name!r} is a {type(component).__name__}; expected an object with "
                    f"state_dict and load_state_dict, under any name but {self._RNG!r}"
                )
            checkpoint.register(name, component, adapter=_SafetensorsAdapter())
        return checkpoint.register(self._RNG, GlobalRNGState(), adapter=_SafetensorsAdapter())

    def save(self, components: Mapping[str, Stateful], iteration: int) -> Path:
        """Save ``components`` as of ``iteration`` and return the checkpoint's folder.

        Raises:
            ValueError: a later iteration is already there (a fresh run in a used directory), a
                component has no state dict, or a state dict holds something else than
                :class:`Stateful` allows.
        """
        latest = self._rotation.latest()
        if latest is not None and (newest := self._iteration(latest)) > iteration:
            raise ValueError(
                f"cannot save iteration {iteration}: {self._rotation.directory} already holds "
                f"iteration {newest}; resume from it or choose another directory"
            )
        saved = self._rotation.save(
            self._bind(components), step=iteration, metadata={"iteration": iteration}
        )
        for leftover in self._rotation.directory.glob(".checkpoint-*"):  # of an earlier crash
            shutil.rmtree(leftover, ignore_errors=True)
        return saved

    def load_latest(self, components: Mapping[str, Stateful]) -> int | None:
        """Restore the newest checkpoint into ``components``.

        Returns:
            Its iteration, or None where there is no checkpoint yet (then nothing changes).

        Raises:
            ValueError: the checkpoint was made of other components.
            torchrl.checkpoint.CheckpointError: a component could not take its state; those before
                it in the order of names have already been restored.
        """
        latest = self._rotation.latest()
        if latest is None:
            return None
        stored = set(Checkpoint.manifest(latest)["components"]) - {self._RNG}
        if stored != set(components):
            raise ValueError(
                f"{latest.name} holds components {sorted(stored)}, got {sorted(components)}"
            )
        checkpoint = self._bind(components)
        checkpoint.load(latest, components=list(components))
        checkpoint.load(latest, components=[self._RNG])  # last: loading may itself draw numbers
        return self._iteration(latest)

    @staticmethod
    def _iteration(path: Path) -> int:
        return int(Checkpoint.manifest(path)["metadata"]["iteration"])
