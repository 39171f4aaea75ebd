"""Episodes in `Minari <https://minari.farama.org>`_ datasets; needs the ``minari`` extra.

Rewards are no part of a demonstration, but Minari stores one per step: they are written as NaN, so
that no one trains on them by accident. Task parameters travel as the episode's reset ``options``,
under ``task``, provenance as one entry of the dataset's metadata.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl.data.provenance import Provenance, parse_provenance
from pemirl_trl.data.recording import Recording
from pemirl_trl.files import check_fields, parse_json

__all__ = ["METADATA", "minari_folder", "read_minari", "write_minari"]

METADATA = Path("data/metadata.json")
"""What makes a folder a Minari dataset."""

_METADATA_KEY = "pemirl_trl"


def _import_minari() -> tuple[Any, Any]:
    try:
        import minari
        from gymnasium import spaces
    except ImportError as error:
        raise ImportError("Minari datasets need: pip install pemirl-trl[minari]") from error
    return minari, spaces


def write_minari(
    dataset_id: str,
    pairs: Sequence[tuple[Tensor, Tensor]],
    terminated: Sequence[bool],
    task: TensorDictBase | None,
    metadata: dict[str, Any],
    *,
    choices: int | None = None,
    **described: Any,
) -> None:
    """Create the local Minari dataset ``dataset_id`` of M episodes.

    Args:
        dataset_id: ``(namespace/)(environment/)name-v<version>``.
        pairs: ``(observation [L+1, S], action [L, A])`` of each episode.
        terminated: whether it ended by itself; otherwise it is written as truncated.
        task: batch_size ``[M]`` or None.
        metadata: JSON mapping, stored under one key of the dataset's metadata.
        choices: n, of actions that are indices ``[M, T]``; None: they are vectors.
        described: passed on to ``minari.create_dataset_from_buffers`` (``author``,
            ``author_email``, ``code_permalink``, ``algorithm_name``, ``description``, ...).
    """
    minari, spaces = _import_minari()
    buffers = [
        minari.data_collector.EpisodeBuffer(
            id=i,
            options=None if task is None else {"task": task[i].to_dict(convert_tensors="numpy")},
            observations=observation.numpy(),
            actions=action.numpy(),
            rewards=np.full(len(action), np.nan),
            terminations=_last(len(action), ended),
            truncations=_last(len(action), not ended),
        )
        for i, ((observation, action), ended) in enumerate(zip(pairs, terminated, strict=True))
    ]
    observation, action = pairs[0]
    with warnings.catch_warnings():
        # One warning per descriptive field left out; they matter for a public upload only.
        warnings.filterwarnings("ignore", category=UserWarning, module="minari")
        dataset = minari.create_dataset_from_buffers(
            dataset_id,
            buffers,
            observation_space=spaces.Box(-np.inf, np.inf, observation.shape[1:], np.float32),
            action_space=(
                spaces.Box(-np.inf, np.inf, action.shape[1:], np.float32)
                if choices is None
                else spaces.Discrete(choices)
            ),
            **described,
        )
    dataset.storage.update_metadata({_METADATA_KEY: json.dumps(metadata)})


def minari_folder(dataset_id: str) -> Path:
    """The folder in which Minari keeps the local dataset ``dataset_id``.

    Raises:
        ImportError: the ``minari`` extra is not installed.
        FileNotFoundError: there is no such dataset on this machine.
    """
    minari, _ = _import_minari()
    there = sorted(minari.list_local_datasets())
    if dataset_id not in there:
        raise FileNotFoundError(
            f"no Minari dataset {dataset_id} on this machine; there are {there}. minari download "
            "fetches one, MINARI_DATASETS_PATH says where they lie"
        )
    return Path(minari.load_dataset(dataset_id).storage.data_path).parent


def read_minari(folder: Path) -> Recording:
    """Read a Minari dataset from its folder, written by anyone.

    Returns:
        Episodes as stored: an observation may be a dictionary of arrays, actions of n choices are
        counted from 0. Task parameters are there if every episode has some, and the provenance is
        what :func:`write_minari` was given, if it wrote it.

    Raises:
        ImportError: the ``minari`` extra is not installed.
        ValueError: observations or actions are neither of these, or foreign metadata.
    """
    minari, spaces = _import_minari()
    dataset = minari.MinariDataset(folder / METADATA.parent)
    dataset_id = dataset.id
    observed, acted = dataset.observation_space, dataset.action_space
    if not isinstance(observed, spaces.Box | spaces.Dict):
        raise ValueError(f"{dataset_id} observes {observed}; expected a Box, or a Dict of Boxes")
    if not isinstance(acted, spaces.Box | spaces.Discrete):
        raise ValueError(f"{dataset_id} has the actions {acted}; expected a Box or Discrete")
    choices = int(acted.n) if isinstance(acted, spaces.Discrete) else None
    first = 0 if choices is None else int(acted.start)
    stored = list(dataset.iterate_episodes())
    episodes = [(one.observations, np.asarray(one.actions) - first) for one in stored]
    ended = [bool(np.any(one.terminations)) for one in stored]
    facts = dataset.storage.get_episode_metadata(dataset.episode_indices)
    tasks = [fact.get("options", {}).get("task") for fact in facts]
    task = (
        torch.stack([TensorDict(_to_tensors(t)) for t in tasks])
        if all(t is not None for t in tasks)
        else None
    )
    provenance = _provenance(dataset_id, dataset.storage.metadata.get(_METADATA_KEY))
    return Recording(episodes, ended, provenance, task, choices)


def _provenance(dataset_id: str, stored: str | None) -> Provenance:
    """What :func:`write_minari` stored, or the dataset's name."""
    if stored is None:
        return Provenance(environment=dataset_id)
    what = f"the metadata of {dataset_id}"
    fields = check_fields(parse_json(stored, what), {"provenance": dict}, what)
    return parse_provenance(fields["provenance"], what)


def _last(steps: int, value: bool) -> NDArray[np.bool_]:
    """Flags of so many steps, the last one ``value`` and the others False."""
    flags = np.zeros(steps, dtype=bool)
    flags[-1] = value
    return flags


def _to_tensors(nested: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _to_tensors(value) if isinstance(value, dict) else torch.as_tensor(np.asarray(value))
        for key, value in nested.items()
    }
