"""The file of a set of demonstrations: which tensors, which facts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from tensordict import TensorDictBase
from torch import Tensor

from pemirl_trl.data.conversion import task_batch
from pemirl_trl.data.provenance import Provenance, parse_provenance
from pemirl_trl.files import check_fields, read_tensors, write_tensors

__all__ = ["read_demonstrations", "write_demonstrations"]

_KIND = "demonstrations"
_SCHEMA_VERSION = 1
_OPTIONAL = ("length", "terminated")
_HEADER = {"schema_version": int, "episodes": int, "horizon": int, "provenance": dict}


def write_demonstrations(
    path: str | Path,
    observation: Tensor,
    action: Tensor,
    task: TensorDictBase | None,
    provenance: Provenance,
    length: Tensor | None = None,
    terminated: Tensor | None = None,
) -> None:
    """Write one safetensors file, atomically.

    Args:
        path: the file.
        observation: ``[M, T+1, S]``; action: ``[M, T, A]``; task: batch_size ``[M]`` or None.
        provenance: where they come from.
        length, terminated: ``[M]``, or None.

    Raises:
        OSError: it cannot be written; the message names the file and says what to do.
    """
    tensors = {"observation": observation, "action": action}
    ends = {"length": length, "terminated": terminated}
    tensors |= {name: value for name, value in ends.items() if value is not None}
    if task is not None:
        tensors |= {f"task.{k}": v for k, v in task.flatten_keys(".").items()}
    header = {
        "schema_version": _SCHEMA_VERSION,
        "episodes": action.shape[0],
        "horizon": action.shape[1],
        "provenance": asdict(provenance),
    }
    write_tensors(path, tensors, kind=_KIND, header=header)


def read_demonstrations(
    path: str | Path,
) -> tuple[Tensor, Tensor, TensorDictBase | None, Provenance, Tensor | None, Tensor | None]:
    """Read what :func:`write_demonstrations` wrote, in the order of its arguments.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: another kind of file, another schema version, a damaged file, tensors that are
            no part of the schema, or sizes that are not the header's; the message names the file.
    """
    tensors, header = read_tensors(path, kind=_KIND)
    check_fields(header, _HEADER, f"the header of {path}")
    if header["schema_version"] != _SCHEMA_VERSION:
        raise ValueError(
            f"{path} has demonstration schema {header['schema_version']}; "
            f"this version reads schema {_SCHEMA_VERSION}"
        )
    provenance = parse_provenance(header["provenance"], f"the provenance in {path}")
    _check_names(tensors, path)
    observation, action = tensors.pop("observation"), tensors.pop("action")
    if tuple(action.shape[:2]) != (header["episodes"], header["horizon"]):
        raise ValueError(
            f"{path} states {header['episodes']} episodes of {header['horizon']} steps, "
            f"but its actions are {tuple(action.shape)}"
        )
    length, terminated = (tensors.pop(name, None) for name in _OPTIONAL)
    task = _task(tensors, len(action), path)
    return observation, action, task, provenance, length, terminated


def _check_names(tensors: Mapping[str, Tensor], path: str | Path) -> None:
    schema = {"observation", "action"}
    missing = sorted(schema - tensors.keys())
    unknown = sorted(
        name
        for name in tensors.keys() - schema - {*_OPTIONAL}
        if not name.startswith("task.") or "" in name.split(".")
    )
    if missing or unknown:
        raise ValueError(
            f"{path} lacks the tensors {missing} and has unknown ones {unknown[:8]}; expected "
            "observation, action, length, terminated and task.<name>"
        )


def _task(tensors: Mapping[str, Tensor], episodes: int, path: str | Path) -> TensorDictBase | None:
    if not tensors:
        return None
    both = sorted(name for name in tensors if any(n.startswith(f"{name}.") for n in tensors))
    if both:
        raise ValueError(f"{path}: {both} are tensors and groups of tensors; expected either")
    values = {name.removeprefix("task."): value for name, value in tensors.items()}
    try:
        return task_batch(values, episodes).unflatten_keys(".")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
