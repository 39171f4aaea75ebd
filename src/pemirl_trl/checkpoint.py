"""Files that outlive a run: atomic writes, training checkpoints, weights to share.

Nothing here unpickles. Tensors go to safetensors files; whatever is not a tensor (keys, counters,
optimiser options) goes to JSON in the header of the same file.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torchrl.checkpoint import Checkpoint, CheckpointAdapter, CheckpointRotation, GlobalRNGState

__all__ = [
    "Stateful",
    "TrainingCheckpoint",
    "atomic_path",
    "load_weights",
    "read_metadata",
    "read_tensors",
    "save_weights",
    "write_tensors",
]

_HEADER_KEY = "pemirl_trl"
_FILE_VERSION = 1


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary sibling of ``path`` that replaces ``path`` once the block succeeds.

    A reader sees the old file or the new one, never half of one; an error leaves the old one.
    The temporary name keeps the suffix, from which some writers take the format.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex}{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _digest(tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 over the names, dtypes, shapes and bytes of ``tensors``, in the order of names."""
    sha = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        sha.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        sha.update(tensor.flatten().view(torch.uint8).numpy().data)
    return sha.hexdigest()


def write_tensors(
    path: str | Path, tensors: Mapping[str, Tensor], *, kind: str, header: Mapping[str, Any]
) -> None:
    """Write ``tensors`` and a JSON ``header`` to one safetensors file, atomically.

    ``kind`` says what the file is; :func:`read_tensors` refuses a file of another kind.
    """
    # Clones, since safetensors refuses tensors that share memory (tied weights, expanded views).
    plain = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format)
        for name, tensor in tensors.items()
    }
    facts = {"kind": kind, "version": _FILE_VERSION, "sha256": _digest(plain), "header": header}
    with atomic_path(path) as temporary:
        save_file(plain, temporary, metadata={_HEADER_KEY: json.dumps(facts)})


def read_tensors(path: str | Path, *, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what :func:`write_tensors` wrote: CPU tensors by name, and the header.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: not a safetensors file, of another kind or version, or altered since written.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no {kind} file at {path}")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(
            f"{path} is not a readable safetensors file ({error}); expected a {kind} file"
        ) from error
    if _HEADER_KEY not in metadata:
        raise ValueError(
            f"{path} is a safetensors file with tensors {sorted(tensors)[:8]}, but pemirl_trl did "
            f"not write it; expected a {kind} file"
        )
    facts = json.loads(metadata[_HEADER_KEY])
    found = (facts["kind"], facts["version"])
    if found != (kind, _FILE_VERSION):
        raise ValueError(
            f"{path} holds {found[0]!r}, file version {found[1]}; "
            f"expected {kind!r}, file version {_FILE_VERSION}"
        )
    if _digest(tensors) != facts["sha256"]:
        raise ValueError(f"{path} is damaged: its tensors do not match the SHA-256 in its header")
    return tensors, facts["header"]


# --- training state ----------------------------------------------------------------------------


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


# --- weights to share --------------------------------------------------------------------------


def _state_tensors(name: str, module: nn.Module) -> dict[str, Tensor]:
    """State dict of ``module`` with names ``<name>.<key>``."""
    state = module.state_dict()
    others = sorted(key for key, value in state.items() if not isinstance(value, Tensor))
    if "." in name or others:
        raise ValueError(
            f"module {name!r}: expected a name without '.' and a state dict of tensors"
            + (f", got other entries {others}" if others else "")
        )
    return {f"{name}.{key}": value for key, value in state.items()}


def save_weights(
    path: str | Path, modules: Mapping[str, nn.Module], metadata: Mapping[str, str]
) -> None:
    """Write the weights of named ``modules`` and ``metadata`` to one safetensors file, atomically.

    Raises:
        ValueError: a module's name holds ``.``, or its state dict something else than tensors.
    """
    tensors: dict[str, Tensor] = {}
    for name, module in modules.items():
        tensors |= _state_tensors(name, module)
    write_tensors(path, tensors, kind="weights", header={"metadata": dict(metadata)})


def read_metadata(path: str | Path) -> dict[str, str]:
    """The metadata of a file written by :func:`save_weights`.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_tensors`.
    """
    return dict(read_tensors(path, kind="weights")[1]["metadata"])


def load_weights(path: str | Path, modules: Mapping[str, nn.Module]) -> dict[str, str]:
    """Load weights saved by :func:`save_weights` into ``modules`` and return the metadata.

    Modules of the file that are not asked for are left alone; each module asked for must match
    entirely, and is compared before any of them is changed.

    Raises:
        ValueError: keys are missing or unexpected, or shapes or dtypes differ: all are named.
    """
    tensors, header = read_tensors(path, kind="weights")
    expected: dict[str, Tensor] = {}
    for name, module in modules.items():
        expected |= _state_tensors(name, module)
    asked = {key: value for key, value in tensors.items() if key.split(".", 1)[0] in modules}
    problems = [
        *(f"missing {key}" for key in sorted(expected.keys() - asked.keys())),
        *(f"unexpected {key}" for key in sorted(asked.keys() - expected.keys())),
    ]
    for key in sorted(expected.keys() & asked.keys()):
        got, want = asked[key], expected[key]
        if got.shape != want.shape or got.dtype != want.dtype:
            problems.append(
                f"{key} is {tuple(got.shape)} {got.dtype}, "
                f"expected {tuple(want.shape)} {want.dtype}"
            )
    if problems:
        raise ValueError(f"{path} does not fit the modules: " + "; ".join(problems))
    for name, module in modules.items():
        prefix = f"{name}."
        module.load_state_dict(
            {key.removeprefix(prefix): v for key, v in asked.items() if key.startswith(prefix)}
        )
    return dict(header["metadata"])
