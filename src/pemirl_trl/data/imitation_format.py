"""Episodes in the layout of the library imitation: ``obs [T+1]``, ``acts [T]``, ``terminal``.

Its datasets on disk (``imitation.data.serialize.save``) are folders of Arrow files and need the
``arrow`` extra; its older ``.npz`` archives need nothing. What is pickled there (``infos``, and its
oldest files as a whole) is never opened: a pickle runs code.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pemirl_trl.data.lerobot_format import arrow_module
from pemirl_trl.data.provenance import Provenance
from pemirl_trl.data.recording import Recording, npz_arrays, source_name
from pemirl_trl.files import expanded, parse_json

__all__ = ["STATE", "read_imitation"]

STATE = Path("state.json")
"""What makes a folder a dataset on disk of the library datasets, in which imitation writes."""
_COLUMNS = ("obs", "acts", "terminal")


def read_imitation(source: str | Path | Iterable[Any]) -> Recording:
    """Read trajectories of imitation.

    Args:
        source: a folder that it saved, an ``.npz`` file, or its trajectories themselves, objects
            with ``obs``, ``acts`` and ``terminal``.

    Raises:
        ImportError: a folder, and the ``arrow`` extra is not installed.
        FileNotFoundError: there is no such file or folder.
        ValueError: another layout, or a pickle.
    """
    name = source_name(source)
    if isinstance(source, str | Path):
        path = expanded(source)
        rows = _of_folder(path) if path.is_dir() else _of_archive(path)
    else:
        rows = [_of_object(one, index) for index, one in enumerate(source)]
    return Recording(
        [(row["obs"], row["acts"]) for row in rows],
        [bool(row["terminal"]) for row in rows],
        Provenance(command=f"read from trajectories of imitation: {name}"),
    )


def _of_object(trajectory: Any, index: int) -> Mapping[str, Any]:
    missing = [name for name in _COLUMNS if not hasattr(trajectory, name)]
    if missing:
        raise ValueError(
            f"trajectory {index} is a {type(trajectory).__name__} without {', '.join(missing)}; "
            "expected a Trajectory of imitation, with obs, acts and terminal"
        )
    return {name: getattr(trajectory, name) for name in _COLUMNS}


def _of_folder(folder: Path) -> list[Mapping[str, Any]]:
    """The rows of a dataset on disk, which are Arrow streams."""
    ipc = arrow_module("ipc")
    state = parse_json((folder / STATE).read_text("utf-8"), str(folder / STATE))
    rows: list[Mapping[str, Any]] = []
    for entry in state["_data_files"]:
        file = folder / entry["filename"]
        with ipc.open_stream(file) as stream:
            there = stream.schema.names
            if not {*_COLUMNS} <= {*there}:
                raise ValueError(f"{file} has the columns {there}; expected {[*_COLUMNS]}")
            rows += stream.read_all().select([*_COLUMNS]).to_pylist()
    return [{**row, "obs": np.asarray(row["obs"]), "acts": np.asarray(row["acts"])} for row in rows]


def _of_archive(path: Path) -> list[Mapping[str, Any]]:
    """The rows of an archive, whose ``indices`` are where trajectories but the first begin."""
    arrays = npz_arrays(path, leave_out=("infos",))
    needed = (*_COLUMNS, "indices")
    if not {*needed} <= {*arrays}:
        raise ValueError(f"{path} has the arrays {sorted(arrays)}; expected {[*needed]}")
    starts = arrays["indices"].astype(np.int64)
    # One observation more than actions in each of the trajectories before.
    observed = np.split(arrays["obs"], starts + np.arange(len(starts)) + 1)
    acted: list[NDArray[Any]] = np.split(arrays["acts"], starts)
    ends = arrays["terminal"].reshape(-1)
    if len(ends) != len(acted):
        raise ValueError(
            f"{path} says of {len(ends)} trajectories whether they ended, and holds {len(acted)}"
        )
    columns = zip(observed, acted, ends, strict=True)
    return [dict(zip(_COLUMNS, values, strict=True)) for values in columns]
