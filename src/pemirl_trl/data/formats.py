"""Whose format a file or folder of demonstrations has, told by its name and what lies in it."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pemirl_trl.data.d4rl_format import read_d4rl
from pemirl_trl.data.imitation_format import STATE, read_imitation
from pemirl_trl.data.lerobot_format import INFO, lerobot_entries, read_lerobot
from pemirl_trl.data.minari_format import METADATA, minari_folder, read_minari
from pemirl_trl.data.provenance import Provenance
from pemirl_trl.data.recording import Recording, npz_arrays
from pemirl_trl.files import expanded

__all__ = ["format_of", "located", "read_source"]

_Format = Literal["own", "arrays", "minari", "lerobot", "imitation", "d4rl"]
_MINARI = "minari:"
_PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")
_HDF5 = (".hdf5", ".h5")
_KNOWN = (
    "a file of DemonstrationDataset.save (.safetensors), .npz or .hdf5, the folder of a LeRobot or "
    f"imitation dataset, or {_MINARI}NAME"
)


def located(source: str | Path) -> Path:
    """The file or folder that is meant; of ``"minari:NAME"`` the folder that Minari keeps it in.

    Raises:
        ImportError, FileNotFoundError: as :func:`pemirl_trl.data.minari_format.minari_folder`.
    """
    name = str(source)
    if name.startswith(_MINARI):
        return minari_folder(name.removeprefix(_MINARI))
    return expanded(source)


def format_of(path: Path) -> _Format:
    """Whose format it is.

    Args:
        path: of :func:`located`.

    Raises:
        FileNotFoundError: there is no such file or folder.
        ValueError: a pickle, or something that nothing here reads; says what to do.
    """
    if path.is_dir():
        return _of_folder(path)
    if path.suffix in _PICKLES:
        raise ValueError(
            f"{path} is a pickle, and opening one runs whatever code is in it: it is not read. "
            "Where you trust it, convert it once. Of imitation: serialize.save('folder', "
            "serialize.load('file.pkl')), of imitation.data, and give the folder. Of anything "
            "else: DemonstrationDataset.from_episodes(pairs).save('mine.safetensors')"
        )
    if path.suffix in _HDF5:
        return "d4rl"
    return _of_archive(path) if path.suffix == ".npz" and path.is_file() else "own"


def _of_folder(path: Path) -> _Format:
    if (path / INFO).is_file():
        return "lerobot"
    if (path / STATE).is_file():
        return "imitation"
    if (path / METADATA).is_file():
        return "minari"
    if (path / "dataset_dict.json").is_file():
        raise ValueError(f"{path} is a set of several datasets; give the folder of one of them")
    there = sorted(child.name for child in path.iterdir())[:8]
    raise ValueError(
        f"{path} is a folder with {there}, of no format that is known here; expected {_KNOWN}"
    )


def _of_archive(path: Path) -> _Format:
    """Which of the three layouts an archive has, by the names of its arrays."""
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path} is not a NumPy archive; expected {_KNOWN}")
    with zipfile.ZipFile(path) as archive:
        names = {name.removesuffix(".npy") for name in archive.namelist()}
    layouts: dict[_Format, set[str]] = {
        "arrays": {"observation"},
        "imitation": {"obs", "acts"},
        "d4rl": {"observations", "actions"},
    }
    for layout, needed in layouts.items():
        if needed <= names:
            return layout
    raise ValueError(
        f"{path} has the arrays {sorted(names)}; expected observation [M, T+1, S] and action "
        "[M, T, A] (without it: demonstrations without actions), or the layout of imitation (obs, "
        "acts) or of D4RL (observations, actions)"
    )


def read_source(path: Path, observation_keys: Sequence[str] | None = None) -> Recording:
    """What a file or folder holds whose format is not ours.

    Args:
        path: of a format that :func:`format_of` knows.
        observation_keys: which entries make the observation, where its frames have several.

    Raises:
        FileNotFoundError, ImportError, ValueError: as the format's own reader.
    """
    match format_of(path):
        case "minari":
            return read_minari(path)
        case "lerobot":
            several = len(lerobot_entries(path)) > 1
            return read_lerobot(path, observation_keys if several else None)
        case "imitation":
            return read_imitation(path)
        case "d4rl":
            return read_d4rl(path)
        case _:
            return _arrays(path)


def _arrays(path: str | Path) -> Recording:
    """Read ``observation [M, T+1, S]`` and ``action [M, T, A]`` of a NumPy archive.

    Without ``action`` they are demonstrations without actions. Where there is ``length [M]``,
    episodes are shorter than T, and ``terminated [M]`` says whether they ended by themselves.
    """
    arrays = npz_arrays(path)
    observation = arrays["observation"]
    action = arrays.get("action", [None] * len(observation))
    length = arrays.get("length")
    ended = arrays.get("terminated")
    counts = {name: len(values) for name, values in arrays.items() if values.ndim}
    if len({*counts.values()}) > 1:
        raise ValueError(f"{path} has arrays of {counts} episodes; expected as many of each")
    if length is None:
        pairs = [*zip(observation, action, strict=True)]
    else:
        rows = zip(observation, action, length.tolist(), strict=True)
        pairs = [(o[: n + 1], None if a is None else a[:n]) for o, a, n in rows]
    return Recording(
        pairs,
        None if ended is None else ended.astype(bool).tolist(),
        Provenance(command=f"read from the arrays of {path}"),
    )
