"""Episodes in D4RL's layout: arrays of all steps, one after another, and flags where episodes end.

``observations [N, S]``, ``actions [N, A]``, ``terminals [N]`` (ended by itself), ``timeouts [N]``
(cut) and, in some, ``next_observations [N, S]``. Without the latter the state that the last action
of an episode led to was not recorded: the action is left out, and an episode that ended has its end
at the last state there is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pemirl_trl.data.provenance import Provenance
from pemirl_trl.data.recording import Recording, npz_arrays, source_name
from pemirl_trl.files import regular_file

__all__ = ["read_d4rl"]

_NEEDED = ("observations", "actions", "terminals", "timeouts")
_NEXT = "next_observations"


def read_d4rl(source: str | Path | Mapping[str, ArrayLike]) -> Recording:
    """Read a dataset in D4RL's layout.

    Args:
        source: an ``.hdf5`` or ``.npz`` file, or a mapping of its arrays (``env.get_dataset()``).

    Raises:
        ImportError: an ``.hdf5`` file, and the ``hdf5`` extra is not installed.
        FileNotFoundError: there is no such file.
        ValueError: arrays that are missing or of unequal length, or observations that were reset
            where no flag says so.
    """
    name = source_name(source)
    arrays = _arrays(source)
    missing = [key for key in _NEEDED if key not in arrays]
    if missing:
        cure = "; without timeouts nobody knows where a time limit cut an episode"
        raise ValueError(
            f"{name} has the arrays {sorted(arrays)}; expected {missing} too"
            + (cure if missing == ["timeouts"] else "")
        )
    lengths = {key: len(value) for key, value in arrays.items()}
    if len({*lengths.values()}) > 1:
        raise ValueError(f"{name} has arrays of the lengths {lengths}; expected one row per step")
    terminal, timeout = (arrays[key].reshape(-1).astype(bool) for key in ("terminals", "timeouts"))
    stops = np.flatnonzero(terminal | timeout) + 1
    if not len(stops) or stops[-1] != len(terminal):
        stops = np.append(stops, len(terminal))  # the recording stopped inside an episode
    spans = [*zip(np.append(0, stops[:-1]).tolist(), stops.tolist(), strict=True)]
    episodes = [_episode(arrays, slice(*s), f"{name}: episode {i}") for i, s in enumerate(spans)]
    kept = [i for i, (_, action) in enumerate(episodes) if len(action)]
    told = f"read from a dataset in D4RL's layout: {name}"
    if len(kept) < len(episodes):
        told += f"; without {len(episodes) - len(kept)} episodes of a single state"
    ended = [bool(terminal[spans[i][1] - 1]) for i in kept]
    return Recording([episodes[i] for i in kept], ended, Provenance(command=told))


def _arrays(source: str | Path | Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
    """The arrays of the layout that a source has, by name."""
    if isinstance(source, Mapping):
        there: Mapping[str, Any] = source
    elif Path(source).suffix == ".npz":
        there = npz_arrays(source)
    else:
        return _of_hdf5(regular_file(source, "hdf5"))
    return {key: np.asarray(there[key]) for key in (*_NEEDED, _NEXT) if key in there}


def _of_hdf5(path: Path) -> dict[str, NDArray[Any]]:
    try:
        import h5py
    except ImportError as error:
        raise ImportError("HDF5 files need: pip install pemirl-trl[hdf5]") from error
    try:
        with h5py.File(path, "r") as file:
            return {key: file[key][()] for key in (*_NEEDED, _NEXT) if key in file}
    except OSError as error:
        raise ValueError(f"{path} is not a readable HDF5 file ({error})") from error


def _episode(
    arrays: Mapping[str, NDArray[Any]], rows: slice, what: str
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Observations ``[L+1, S]`` and actions ``[L, ...]`` of the steps ``rows``."""
    observation, action = arrays["observations"][rows], arrays["actions"][rows]
    if _NEXT not in arrays:
        return observation, action[:-1]
    following = arrays[_NEXT][rows]
    if (following[:-1] != observation[1:]).any():
        raise ValueError(
            f"{what} was reset on the way: its next_observations are not the observations that "
            "follow. Flag its end in terminals or timeouts, or leave next_observations out"
        )
    return np.concatenate([observation, following[-1:]]), action
