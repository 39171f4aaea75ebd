"""Episodes in LeRobot datasets of format v3, from a local folder; needs the ``arrow`` extra.

``meta/info.json`` says which entries a frame has, ``meta/episodes/*/*.parquet`` how long each
episode is, ``data/*/*.parquet`` holds the frames. Frame t has what was observed at t and the action
taken there; what the last action led to was not recorded, so an episode of F frames makes F
observations and F - 1 actions. Videos and images are not decoded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pemirl_trl.data.provenance import Provenance
from pemirl_trl.data.recording import Recording
from pemirl_trl.files import expanded, parse_json

__all__ = ["INFO", "arrow_module", "lerobot_entries", "read_lerobot"]

INFO = Path("meta/info.json")
"""What makes a folder a LeRobot dataset."""
_OBSERVED, _ACTION = "observation.", "action"
_PICTURES = ("video", "image")
_CONVERTER = "python -m lerobot.datasets.v30.convert_dataset_v21_to_v30 --repo-id=..."


def arrow_module(name: str) -> Any:
    """A module of pyarrow.

    Raises:
        ImportError: the ``arrow`` extra is not installed.
    """
    try:
        return __import__(f"pyarrow.{name}", fromlist=[name])
    except ImportError as error:
        raise ImportError(
            "LeRobot and imitation datasets need: pip install pemirl-trl[arrow]"
        ) from error


def lerobot_entries(folder: str | Path) -> list[str]:
    """The entries of an observation that are numbers, without their prefix ``observation.``."""
    return [*_numbers_of(_features(expanded(folder)))]


def read_lerobot(folder: str | Path, observation_keys: Sequence[str] | None = None) -> Recording:
    """Read the frames of a LeRobot dataset.

    Args:
        folder: of the dataset, with ``meta`` and ``data``.
        observation_keys: which entries make the observation, in this order, such as ``["state"]``
            or ``["observation.state"]``; None: the only one that is numbers.

    Raises:
        ImportError: the ``arrow`` extra is not installed.
        FileNotFoundError: a part of it is missing.
        ValueError: another version of the format, an entry that is a video or not there, or files
            that contradict each other; the message names the folder.
    """
    folder = expanded(folder)
    features = _features(folder)
    keys = _chosen(features, observation_keys, folder)
    observed = [_OBSERVED + key for key in keys]
    acted = [_ACTION] if _ACTION in features else []
    columns = [*observed, *acted]
    frames = _frames(folder, {name: features[name] for name in columns})
    left_out = [
        f"{name} ({feature['dtype']})"
        for name, feature in features.items()
        if name.startswith(_OBSERVED) and name not in columns
    ]
    told = f"read from a LeRobot dataset: {', '.join(columns)}"
    told += f"; not read: {', '.join(left_out)}" if left_out else ""
    return Recording(
        [
            (
                np.concatenate([frames[name][a:b] for name in observed], -1),
                frames[_ACTION][a : b - 1] if acted else None,
            )
            for a, b in _spans(folder, frames)
        ],
        None,
        Provenance(environment=folder.name, command=told),
    )


def _features(folder: Path) -> Mapping[str, Mapping[str, Any]]:
    """The entries of a frame, by name: ``dtype`` and ``shape``."""
    file = folder / INFO
    if not file.is_file():
        raise FileNotFoundError(f"no file {file}: expected the folder of a LeRobot dataset")
    info = parse_json(file.read_text("utf-8"), str(file))
    version = info.get("codebase_version") if isinstance(info, dict) else None
    if not str(version).startswith("v3."):
        raise ValueError(
            f"{folder} is a LeRobot dataset of version {version}; expected v3.x. LeRobot itself "
            f"converts version 2.1: {_CONVERTER}"
        )
    features = info.get("features")
    well_formed = isinstance(features, dict) and all(
        isinstance(f, dict) and isinstance(f.get("shape"), list) and "dtype" in f
        for f in features.values()
    )
    if not well_formed:
        raise ValueError(f"{file}: features are {features!r}; expected a dtype and a shape of each")
    return features


def _numbers_of(features: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """The observed entries that are numbers, without the prefix, and their types."""
    return {
        name.removeprefix(_OBSERVED): str(feature["dtype"])
        for name, feature in features.items()
        if name.startswith(_OBSERVED) and feature["dtype"] not in (*_PICTURES, "string", "language")
    }


def _chosen(
    features: Mapping[str, Mapping[str, Any]], keys: Sequence[str] | None, folder: Path
) -> list[str]:
    """The entries that make an observation, without their prefix."""
    numbers = [*_numbers_of(features)]
    given = [key.removeprefix(_OBSERVED) for key in keys or ()]
    pictures = [key for key in given if features.get(_OBSERVED + key, {}).get("dtype") in _PICTURES]
    if pictures:
        kind = features[_OBSERVED + pictures[0]]["dtype"]
        raise ValueError(
            f"{folder}: the entry {_OBSERVED}{pictures[0]} is a {kind}, which is not decoded here; "
            f"of its numbers there are {numbers}"
        )
    if keys is None and len(numbers) == 1:
        return numbers
    if not given or len({*given}) < len(given) or not {*given} <= {*numbers}:
        raise ValueError(
            f"{folder} observes the entries {numbers}; expected observation_keys=[...], different "
            f"ones of these, got {None if keys is None else [*keys]}"
        )
    return given


def _frames(folder: Path, features: Mapping[str, Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    """All frames in the order of episodes: the features ``[frames, F]``, and their episode."""
    parquet = arrow_module("parquet")
    files = sorted((folder / "data").glob("*/*.parquet"))
    if not files:
        raise FileNotFoundError(f"no file {folder / 'data/*/*.parquet'}: the dataset has no frames")
    order = ["episode_index", "frame_index"]
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in (*features, *order)}
    for file in files:
        there = parquet.read_schema(file).names
        missing = [name for name in parts if name not in there]
        if missing:
            raise ValueError(f"{file} has the columns {there}; expected {missing} too")
        table = parquet.read_table(file, columns=[*parts])
        for name, found in parts.items():
            shape = features[name]["shape"] if name in features else []
            found.append(_column(table.column(name), prod(shape), f"{file}: {name}"))
    values = {name: np.concatenate(found) for name, found in parts.items()}
    rows = np.lexsort((values["frame_index"][:, 0], values["episode_index"][:, 0]))
    return {name: value[rows] for name, value in values.items()}


def _column(column: Any, size: int, what: str) -> NDArray[Any]:
    """A column of numbers or of (nested) lists of ``size`` numbers, as ``[rows, size]``."""
    rows = len(column)
    flat = column.combine_chunks()
    while hasattr(flat, "storage"):
        flat = flat.storage
    while hasattr(flat.type, "value_type"):
        flat = flat.flatten()
    values = np.asarray(flat.to_numpy(zero_copy_only=False))
    if values.size != rows * size:
        raise ValueError(f"{what} holds {values.size} numbers in {rows} rows; expected {size} each")
    return values.reshape(rows, size)


def _spans(folder: Path, frames: Mapping[str, NDArray[Any]]) -> list[tuple[int, int]]:
    """First and last row, the latter excluded, of each episode that ``meta/episodes`` names."""
    parquet = arrow_module("parquet")
    files = sorted((folder / "meta" / "episodes").glob("*/*.parquet"))
    if not files:
        raise FileNotFoundError(f"no file {folder / 'meta/episodes/*/*.parquet'}")
    stated: dict[int, int] = {}
    for file in files:
        table = parquet.read_table(file, columns=["episode_index", "length"]).to_pydict()
        stated |= dict(zip(table["episode_index"], table["length"], strict=True))
    index, first, count = np.unique(
        frames["episode_index"][:, 0], return_index=True, return_counts=True
    )
    found = dict(zip(index.tolist(), count.tolist(), strict=True))
    odd = sorted(i for i in {*stated, *found} if stated.get(i) != found.get(i))
    steps = frames["frame_index"][:, 0]
    spans = [*zip(index.tolist(), first.tolist(), count.tolist(), strict=True)]
    odd += [i for i, a, n in spans if (steps[a : a + n] != np.arange(n)).any()]
    if odd:
        raise ValueError(
            f"{folder}: meta/episodes states {stated.get(odd[0], 'no')} frames of episode "
            f"{odd[0]}, and data holds {found.get(odd[0], 'none')} ({len(odd)} such episodes): "
            "is the copy whole?"
        )
    short = [i for i, n in found.items() if n < 2]
    if short:
        raise ValueError(f"{folder}: episode {short[0]} has one frame; expected at least two")
    return [(a, a + n) for _, a, n in spans]
