"""Weights to share: state dicts of named modules, with metadata."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from pemirl_trl.files.headers import check_fields
from pemirl_trl.files.tensors import read_tensors, write_tensors

__all__ = ["load_weights", "misfits", "read_metadata", "read_weights", "save_weights"]

_KIND = "weights"


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


def _metadata(content: Any, path: str | Path) -> dict[str, str]:
    """``content`` if it maps strings to strings."""
    fields = dict(content) if isinstance(content, Mapping) else {}
    return check_fields(content, dict.fromkeys(fields, str), f"the metadata of {path}")


def save_weights(
    path: str | Path, modules: Mapping[str, nn.Module], metadata: Mapping[str, str]
) -> None:
    """Write the weights of named ``modules`` and ``metadata`` to one safetensors file, atomically.

    Raises:
        ValueError: a module's name holds ``.``, its state dict something else than tensors, or the
            metadata something else than strings.
        OSError: it cannot be written.
    """
    tensors: dict[str, Tensor] = {}
    for name, module in modules.items():
        tensors |= _state_tensors(name, module)
    header = {"metadata": _metadata(dict(metadata), path)}
    write_tensors(path, tensors, kind=_KIND, header=header)


def read_weights(path: str | Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors, named ``<module>.<key>``, and the metadata of :func:`save_weights`.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_tensors`.
    """
    tensors, header = read_tensors(path, kind=_KIND)
    header = check_fields(header, {"metadata": dict}, f"the header of {path}")
    return tensors, _metadata(header["metadata"], path)


def read_metadata(path: str | Path) -> dict[str, str]:
    """The metadata of a file written by :func:`save_weights`.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_tensors`.
    """
    return read_weights(path)[1]


def misfits(tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> list[str]:
    """What keeps ``tensors`` from taking the places of ``expected``: names, shapes and dtypes."""
    problems = [
        *(f"missing {key}" for key in sorted(expected.keys() - tensors.keys())),
        *(f"unexpected {key}" for key in sorted(tensors.keys() - expected.keys())),
    ]
    for key in sorted(expected.keys() & tensors.keys()):
        got, want = tensors[key], expected[key]
        if got.shape != want.shape or got.dtype != want.dtype:
            problems.append(
                f"{key} is {tuple(got.shape)} {got.dtype}, "
                f"expected {tuple(want.shape)} {want.dtype}"
            )
    return problems


def load_weights(path: str | Path, modules: Mapping[str, nn.Module]) -> dict[str, str]:
    """Load weights saved by :func:`save_weights` into ``modules`` and return the metadata.

    Modules of the file that are not asked for are left alone; each module asked for must match
    entirely, and is compared before any of them is changed.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: keys are missing or unexpected, or shapes or dtypes differ: all are named.
    """
    tensors, metadata = read_weights(path)
    expected: dict[str, Tensor] = {}
    for name, module in modules.items():
        expected |= _state_tensors(name, module)
    asked = {key: value for key, value in tensors.items() if key.split(".", 1)[0] in modules}
    if problems := misfits(asked, expected):
        raise ValueError(f"{path} does not fit the modules: " + "; ".join(problems))
    for name, module in modules.items():
        prefix = f"{name}."
        module.load_state_dict(
            {key.removeprefix(prefix): v for key, v in asked.items() if key.startswith(prefix)}
        )
    return metadata
