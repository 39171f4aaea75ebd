"""Files that hold tensors: written atomically, read without unpickling.

Tensors go to safetensors files; whatever is not a tensor goes to JSON in the header of the same
file. A SHA-256 in the header covers all of it; in files of version 1 it covers the tensors alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from pemirl_trl.files.headers import check_fields, parse_json
from pemirl_trl.files.staging import atomic_path, regular_file

__all__ = ["read_tensors", "write_tensors"]

_HEADER_KEY = "pemirl_trl"
_FILE_VERSION = 2
_READABLE_VERSIONS = (1, 2)
_FACTS = {"kind": str, "version": int, "sha256": str, "header": dict}


def _digest(
    tensors: Mapping[str, Tensor], kind: str, version: int, header: Mapping[str, Any]
) -> str:
    """SHA-256 of kind, version and header, then of the tensors in the order of their names.

    Of a tensor count name, dtype, shape and bytes; of version 1 the tensors alone.
    """
    sha = hashlib.sha256()
    if version > 1:
        sha.update(json.dumps([kind, version, header], sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        sha.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        sha.update(tensor.flatten().view(torch.uint8).numpy().data)
    return sha.hexdigest()


def write_tensors(
    path: str | Path, tensors: Mapping[str, Tensor], *, kind: str, header: Mapping[str, Any]
) -> None:
    """Write ``tensors`` and a JSON ``header`` to one safetensors file, atomically.

    ``kind`` says what the file is; :func:`read_tensors` refuses a file of another kind.

    Raises:
        ValueError: the header holds what JSON cannot, or ``path`` is no place for a file.
        OSError: it cannot be written; the message names the file and says what to do.
    """
    # Clones, since safetensors refuses tensors that share memory (tied weights, expanded views).
    plain = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format)
        for name, tensor in tensors.items()
    }
    try:
        header = json.loads(json.dumps(header))  # as it will be read: tuples become lists
    except TypeError as error:
        raise ValueError(f"{path} is not written: its header is not JSON ({error})") from error
    facts = {
        "kind": kind,
        "version": _FILE_VERSION,
        "sha256": _digest(plain, kind, _FILE_VERSION, header),
        "header": header,
    }
    # Bytes rather than save_file, which stages a file of its own beside this one.
    content = save(plain, metadata={_HEADER_KEY: json.dumps(facts)})
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def read_tensors(path: str | Path, *, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what :func:`write_tensors` wrote: CPU tensors by name, and the header.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: not a regular file, not a safetensors file, of another kind or version, or
            altered since written.
    """
    path = regular_file(path, kind)
    tensors, metadata = _read_safetensors(path, kind)
    if _HEADER_KEY not in metadata:
        raise ValueError(
            f"{path} is a safetensors file with tensors {sorted(tensors)[:8]}, but pemirl_trl did "
            f"not write it; expected a {kind} file"
        )
    what = f"the header of {path}"
    facts = check_fields(parse_json(metadata[_HEADER_KEY], what), _FACTS, what)
    found, version, header = facts["kind"], facts["version"], facts["header"]
    if found != kind or version not in _READABLE_VERSIONS:
        raise ValueError(
            f"{path} holds {found!r}, file version {version}; "
            f"expected {kind!r}, file version {' or '.join(map(str, _READABLE_VERSIONS))}"
        )
    if _digest(tensors, kind, version, header) != facts["sha256"]:
        raise ValueError(
            f"{path} is damaged: its contents do not match the SHA-256 in its header; "
            "copy it anew, or make it anew"
        )
    return tensors, header


def _read_safetensors(path: Path, kind: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, file.metadata() or {}
    except SafetensorError as error:
        raise ValueError(
            f"{path} is not a readable safetensors file ({error}); expected a {kind} file"
        ) from error
