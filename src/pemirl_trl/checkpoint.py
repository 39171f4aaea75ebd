"""Checkpoints of a training run, in files that nothing unpickles.

Tensors, keys, counters and optimiser options of a component go to one file of
:mod:`pemirl_trl.files`. A seal beside them names the run, the iteration and the SHA-256 of every
file: a checkpoint is whole, or it is not used.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from torch import Tensor
from torchrl.checkpoint import Checkpoint, CheckpointAdapter, CheckpointError, GlobalRNGState

from pemirl_trl.files import (
    check_fields,
    expanded,
    file_digest,
    read_tensors,
    staging_folder,
    write_tensors,
    writing,
)

__all__ = ["Stateful", "TrainingCheckpoint", "UnusableCheckpointWarning"]

_SEAL_FIELDS: dict[str, type | tuple[type, ...]] = {
    "iteration": int,
    "identity": (str, type(None)),
    "files": dict,
}


class UnusableCheckpointWarning(UserWarning):
    """A checkpoint is damaged, and an older one was used in its place."""


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
        case None | bool() | int() | float() | str():
            return value
        case _:
            raise ValueError(f"unknown entry {value!r:.80}")


def _read_state(path: Path) -> Any:
    tensors, header = read_tensors(path, kind="state")
    try:
        return _decode(header["state"], tensors)
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: its header is not that of a state") from error


class _SafetensorsAdapter(CheckpointAdapter):
    """Store a component's state dict as one safetensors file.

    TorchRL's own adapter reads memory-mapped folders, where tensordict 0.14 still unpickles a
    non-tensor field if one is present; a checkpoint from someone else could run code that way.
    """

    adapter_id = "pemirl_trl.safetensors"
    file = "state.safetensors"

    def save(self, component: Stateful, path: Path, **_: Any) -> None:
        tensors: dict[str, Tensor] = {}
        state = _encode(component.state_dict(), tensors)
        write_tensors(path / self.file, tensors, kind="state", header={"state": state})

    def load(self, component: Stateful, path: Path, **_: Any) -> None:
        component.load_state_dict(_read_state(path / self.file))


class _Sealed:
    """A folder that holds a checkpoint, and the seal that says what belongs to it.

    Checkpoints of versions before the seal have none; their manifests do not ask for one.
    """

    _SEAL = "seal.safetensors"
    _MANIFEST = "manifest.json"
    metadata = "sealed"  # what a manifest asks for

    def __init__(self, path: Path) -> None:
        self.path = path

    def seal(self, iteration: int, identity: str | None) -> None:
        """Write down every file of the folder."""
        files = {
            file.relative_to(self.path).as_posix(): file_digest(file)
            for file in sorted(self.path.rglob("*"))
            if file.is_file()
        }
        header = {"iteration": iteration, "identity": identity, "files": files}
        write_tensors(self.path / self._SEAL, {}, kind="checkpoint", header=header)

    def verify(self, iteration: int) -> str | None:
        """Return the identity of the run, if the folder is whole and of this iteration.

        Raises:
            ValueError, OSError: it is not; the message names the file at fault.
        """
        file = self.path / self._SEAL
        if not file.exists():
            self._verify_unsealed(iteration)
            return None
        seal = check_fields(read_tensors(file, kind="checkpoint")[1], _SEAL_FIELDS, str(file))
        for name, digest in seal["files"].items():
            if file_digest(self.path / name) != digest:
                raise ValueError(f"{self.path / name} is damaged: its SHA-256 is not {digest}")
        if seal["iteration"] != iteration:
            raise ValueError(f"{self.path} is damaged: its seal says iteration {seal['iteration']}")
        identity: str | None = seal["identity"]
        return identity

    def _verify_unsealed(self, iteration: int) -> None:
        manifest = self.manifest()
        stated = manifest.get("metadata")
        if not isinstance(stated, dict) or stated.get("iteration") != iteration:
            raise ValueError(
                f"{self.path / self._MANIFEST} is damaged: it says {stated!r:.80}, its folder "
                f"iteration {iteration}"
            )
        if self.metadata in stated:
            raise ValueError(f"{self.path / self._SEAL} is missing")
        for record in manifest["components"].values():
            if record["adapter"] == _SafetensorsAdapter.adapter_id:
                _read_state(self.path / record["path"] / _SafetensorsAdapter.file)

    def manifest(self) -> dict[str, Any]:
        """TorchRL's list of the components.

        Raises:
            ValueError, OSError: there is none, or it is something else.
        """
        try:
            content: dict[str, Any] = Checkpoint.manifest(self.path)
        except (CheckpointError, AttributeError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"{self.path / self._MANIFEST} is damaged ({error})") from error
        return content


class TrainingCheckpoint:
    """The last ``keep`` checkpoints of one training run, on :mod:`torchrl.checkpoint`.

    Each checkpoint is a folder ``checkpoint-<iteration>``, staged beside its destination, sealed,
    renamed into place, and only then are older ones removed: a crash never costs the last good
    one. What a killed process had staged is removed by the next. Python's, NumPy's and torch's
    global random states are stored too and restored last, so that a resumed run continues bit for
    bit.

    Args:
        directory: Folder of this run alone, with one writer.
        identity: What tells this run from others, such as its seed and a digest of its inputs;
            checkpoints of another identity are refused. None: whatever is there is taken.
        keep: How many checkpoints to keep, at least 1; with 1, a damaged one has no substitute.

    Raises:
        ValueError: ``keep`` is less than 1.
    """

    _RNG = "global_rng"
    _STAGE = ".checkpoint-"

    def __init__(
        self, directory: str | Path, identity: str | None = None, *, keep: int = 2
    ) -> None:
        if keep < 1:
            raise ValueError(f"keep is {keep}; expected at least 1 checkpoint")
        self._directory = expanded(directory).absolute()
        self._identity = identity
        self._keep = keep
        self._unusable: set[int] = set()  # found on loading; the next save replaces them

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

    def _folders(self) -> dict[int, Path]:
        """Whatever is named like a checkpoint, by iteration, oldest first."""
        if not self._directory.exists():
            return {}
        names = ((re.fullmatch(r"checkpoint-(\d+)", p.name), p) for p in self._directory.iterdir())
        return dict(sorted((int(match[1]), path) for match, path in names if match))

    def save(self, components: Mapping[str, Stateful], iteration: int) -> Path:
        """Save ``components`` as of ``iteration`` and return the checkpoint's folder.

        Raises:
            ValueError: a later iteration is already there (a fresh run in a used directory), a
                component has no state dict, or a state dict holds something else than
                :class:`Stateful` allows.
            OSError: it cannot be written; the message says what to do, older ones are untouched.
        """
        checkpoint = self._bind(components)
        newest = max(self._folders().keys() - self._unusable, default=-1)
        if iteration < 0 or newest > iteration:
            raise ValueError(
                f"cannot save iteration {iteration}: {self._directory} already holds "
                f"iteration {newest}; resume from it or choose another directory"
            )
        destination = self._directory / f"checkpoint-{iteration:012d}"
        with writing(destination), staging_folder(self._directory, self._STAGE) as stage:
            facts = {"iteration": iteration, _Sealed.metadata: True}
            draft = checkpoint.save(stage / destination.name, metadata=facts)
            _Sealed(draft).seal(iteration, self._identity)
            if destination.exists():
                os.replace(destination, stage / "replaced")
            os.replace(draft, destination)
        self._unusable.discard(iteration)
        self._prune()
        return destination

    def _prune(self) -> None:
        folders = self._folders()
        kept = sorted(folders.keys() - self._unusable)[-self._keep :]
        with staging_folder(self._directory, self._STAGE) as bin_:
            for iteration in folders.keys() - set(kept):
                os.replace(folders[iteration], bin_ / str(iteration))  # at once, then file by file
        self._unusable.clear()

    def load_latest(self, components: Mapping[str, Stateful]) -> int | None:
        """Restore the newest checkpoint that is whole into ``components``.

        Returns:
            Its iteration, or None where there is no checkpoint yet (then nothing changes).

        Warns:
            UnusableCheckpointWarning: newer ones are damaged; each is named, with what is wrong.

        Raises:
            ValueError: there are checkpoints and none is whole, or the checkpoint was made by a
                run of another identity or of other components: nothing has changed then. Or a
                component could not take its state: those before it in the order of names have
                already been restored.
        """
        faults: dict[int, str] = {}
        for iteration, path in reversed(self._folders().items()):
            try:
                identity = _Sealed(path).verify(iteration)
                stored = set(_Sealed(path).manifest()["components"]) - {self._RNG}
            except PermissionError:
                raise  # says nothing about the checkpoint
            except (ValueError, OSError) as error:
                faults[iteration] = f"{path.name}: {error}"
                continue
            self._refuse_another(path, identity, stored, set(components))
            self._unusable = set(faults)
            if faults:
                message = f"continued from {path.name}; not usable: {'; '.join(faults.values())}"
                warnings.warn(message, UnusableCheckpointWarning, stacklevel=2)
            self._restore(path, components)
            return iteration
        if faults:
            raise ValueError(
                f"no checkpoint in {self._directory} is usable: {'; '.join(faults.values())}. "
                "Put back a copy of one, or delete that folder to start anew"
            )
        return None

    def _restore(self, path: Path, components: Mapping[str, Stateful]) -> None:
        checkpoint = self._bind(components)
        try:
            checkpoint.load(path, components=list(components))
            checkpoint.load(path, components=[self._RNG])  # last: loading may itself draw numbers
        except CheckpointError as error:
            raise ValueError(f"{path} does not fit its components: {error}") from error

    def _refuse_another(
        self, path: Path, identity: str | None, stored: set[str], asked: set[str]
    ) -> None:
        if None not in (identity, self._identity) and identity != self._identity:
            raise ValueError(
                f"{path} is of the run {identity!r}; expected {self._identity!r}. Choose another "
                "directory, or delete that one to start anew"
            )
        if stored != asked:
            raise ValueError(f"{path} holds components {sorted(stored)}, got {sorted(asked)}")
