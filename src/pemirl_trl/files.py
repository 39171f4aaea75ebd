"""Files that hold tensors: written atomically, read without unpickling.

Tensors go to safetensors files; whatever is not a tensor goes to JSON in the header of the same
file.
"""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

__all__ = [
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
