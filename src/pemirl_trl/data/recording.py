"""What a file of demonstrations holds, whoever wrote it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase

from pemirl_trl.data.provenance import Provenance
from pemirl_trl.files import regular_file

__all__ = ["Recording", "npz_arrays", "source_name"]


@dataclass(frozen=True)
class Recording:
    """Episodes of a format that is not ours, as ``DemonstrationDataset.from_episodes`` takes them.

    Attributes:
        episodes: ``(observation [L+1, S], action [L, A])`` of each; an observation may be a mapping
            of arrays, and actions of n choices are ``[L]``.
        ended: whether each ended by itself; None where the format does not say.
        provenance: where they come from.
        task: ground truth of batch_size ``[M]``, if there is any.
        choices: n, where the format says how many choices the actions are.
    """

    episodes: Sequence[tuple[Any, Any]]
    ended: Sequence[bool] | None
    provenance: Provenance
    task: TensorDictBase | None = None
    choices: int | None = None

    @property
    def has_entries(self) -> bool:
        """Whether observations are mappings of several arrays."""
        return any(isinstance(observation, Mapping) for observation, _ in self.episodes)


def source_name(source: object) -> str:
    """How errors call a source: by its path, or by its type where it is in memory."""
    return str(source) if isinstance(source, str | Path) else f"this {type(source).__name__}"


def npz_arrays(path: str | Path, *, leave_out: Sequence[str] = ()) -> Mapping[str, NDArray[Any]]:
    """The arrays of a NumPy archive, by name; nothing is unpickled.

    Args:
        path: of the ``.npz`` file.
        leave_out: names that nobody reads, which may be pickled objects.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no archive of arrays, or holds pickled objects.
    """
    path = regular_file(path, "npz")
    try:
        archive = np.load(path, allow_pickle=False)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path} is not a NumPy archive ({error}); expected .npz") from error
    arrays = {}
    for name in archive.files:
        if name in leave_out:
            continue
        try:
            arrays[name] = archive[name]
        except ValueError as error:
            raise ValueError(
                f"{path}: {name!r} holds pickled objects, and opening those runs whatever code is "
                f"in them; expected arrays of numbers, such as np.savez(file, {name}=...) writes "
                "where episodes of one length are stacked"
            ) from error
    return arrays
