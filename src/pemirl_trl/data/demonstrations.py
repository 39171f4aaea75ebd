"""Expert demonstrations: where they come from, and their files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from numpy.typing import ArrayLike
from tensordict import NestedKey, TensorDictBase

from pemirl_trl.data.conversion import narrowed, wide_tensor
from pemirl_trl.data.demonstration_file import read_demonstrations, write_demonstrations
from pemirl_trl.data.demonstration_set import DemonstrationSet
from pemirl_trl.data.entries import action_vectors
from pemirl_trl.data.episodes import check_constant, first_episodes, flags_of, pair_of, task_of
from pemirl_trl.data.lengths import steps_after
from pemirl_trl.data.minari_format import read_minari, write_minari
from pemirl_trl.data.provenance import Provenance, parse_provenance
from pemirl_trl.data.validation import stack_episodes
from pemirl_trl.files import check_fields, expanded

__all__ = ["DemonstrationDataset", "Provenance"]


class DemonstrationDataset(DemonstrationSet):
    """M demonstrations of at most T steps, in no particular order and without labels.

    ============== ============== ==============================================================
    field          shape, dtype   what it is
    ============== ============== ==============================================================
    observation    [M, T+1, S]    float32; the last one is what the last action led to
    action         [M, T, A]      float32; discrete ones are one-hot, of A choices
    provenance                    :class:`Provenance`
    task           batch_size [M] ground-truth task parameters, or None. For metrics only: they
                                  never enter :meth:`trajectories`, so no learner sees them.
    length         [M]            int64; how many actions each has; None: all T. What comes after
                                  is padding: the last observation, and actions of 0
    terminated     [M]            bool; whether an episode ended by itself, or was cut; None: what
                                  is shorter than T ended
    absorbing      one bool       whether observations end with an indicator of having ended; see
                                  :meth:`with_absorbing_states`
    ============== ============== ==============================================================

    Construction validates, and detaches what carries an autograd graph; :meth:`from_episodes` takes
    arrays of any floating or integer dtype.

    Example:
        >>> import numpy as np
        >>> episode = np.zeros((101, 6)), np.zeros((100, 2))   # observations, actions
        >>> demos = DemonstrationDataset.from_episodes([episode, episode])
        >>> len(demos), demos.horizon, demos.observation_dim, demos.action_dim
        (2, 100, 6, 2)
        >>> demos.trajectories([0])["next", "observation"].shape
        torch.Size([1, 100, 6])
    """

    # --- from elsewhere ------------------------------------------------------------------------

    @classmethod
    def from_episodes(
        cls,
        episodes: Iterable[tuple[ArrayLike | Mapping[str, Any], ArrayLike]],
        provenance: Provenance | None = None,
        task: Mapping[str, ArrayLike] | TensorDictBase | None = None,
        *,
        terminated: bool | Sequence[bool] | None = None,
        horizon: int | None = None,
        discrete_actions: int | None = None,
        observation_keys: Sequence[str] | None = None,
    ) -> DemonstrationDataset:
        """Build a dataset of ``(observation [L+1, S], action [L, A])`` pairs of arrays or tensors.

        Args:
            episodes: one pair per demonstration, of one length or of several.
            provenance: where they come from.
            task: ground truth, a mapping of name to ``[M, ...]``.
            terminated: whether episodes ended by themselves (a goal reached, a fall), or were cut;
                for all, or for each. None: what is shorter than T ended.
            horizon: T, how long an episode can be; None: as long as the longest of these.
            discrete_actions: n, where actions are integers ``[L]`` from 0 to n - 1.
            observation_keys: which entries of observations that are mappings of arrays
                ``[L+1, ...]`` make the vector, in this order; ``"arm.angle"`` is nested.

        Raises:
            ValueError: mixed dimensions, an off-by-one, NaN, something else than real numbers,
                actions or entries that are not there, or a feature that float32 cannot tell apart;
                the episodes are named.

        Example:
            >>> walk = {"place": [[0], [1], [2]], "speed": [[0], [1], [1]]}, [2, 0]
            >>> data = DemonstrationDataset.from_episodes(
            ...     [walk], discrete_actions=3, observation_keys=["speed", "place"]
            ... )
            >>> data.observation[0, 2], data.action[0, 0], data.discrete
            (tensor([1., 2.]), tensor([0., 0., 1.]), True)
        """
        pairs = [
            pair_of(i, episode, discrete_actions, observation_keys)
            for i, episode in enumerate(episodes)
        ]
        observation, action, length = stack_episodes(pairs)
        several = bool((length < action.shape[1]).any())
        dataset = cls(
            narrowed("observation", observation),
            narrowed("action", action),
            provenance or Provenance(),
            task_of(task, len(pairs)),
            length if several else None,
            flags_of(terminated, len(pairs)),
        )
        return dataset if horizon is None else dataset.padded(horizon)

    @classmethod
    def from_rollouts(
        cls,
        rollouts: TensorDictBase,
        provenance: Provenance | None = None,
        task_key: NestedKey | None = "task",
        *,
        discrete_actions: int | None = None,
    ) -> DemonstrationDataset:
        """Build a dataset of whole episodes collected by TorchRL.

        Args:
            rollouts: batch_size ``[M, T]`` with ``observation``, ``action``,
                ``("next", "observation")`` and, under ``task_key``, task parameters that are
                constant in time (their absence makes a dataset without ground truth). Where
                ``("next", "done")`` says that a row ended before T, its first episode is taken, and
                ``("next", "terminated")`` says how it ended.
            provenance: where they come from.
            task_key: where the ground truth is; None ignores it.
            discrete_actions: n, where actions are indices ``[M, T]`` and not one-hot.

        Raises:
            ValueError: not ``[M, T]``, an episode that was reset on the way, or whose task changed,
                or a feature that float32 cannot tell apart.
        """
        if rollouts.ndim != 2:
            raise ValueError(f"rollouts have batch_size {list(rollouts.shape)}; expected [M, T]")
        observation, following = rollouts["observation"], rollouts["next", "observation"]
        length, terminated = first_episodes(rollouts)
        inside = ~steps_after(length, rollouts.shape[1])[:, 1:]  # [M, T-1]
        check_constant("were reset on the way", observation[:, 1:], following[:, :-1], inside)
        task = None if task_key is None else rollouts.get(task_key, None)
        if task is not None:
            for value in task.values(include_nested=True, leaves_only=True):
                what = "changed their task on the way"
                check_constant(what, value[:, 1:], value[:, :-1], inside)
            task = task[:, 0].clone()
        observation = torch.cat([observation, following[:, -1:]], dim=1)  # [M, T+1, S]
        action = action_vectors(rollouts["action"], discrete_actions, "action", leading=2)
        if bool((length < rollouts.shape[1]).any()):
            rows = [*zip(observation, following, action, length.tolist(), strict=True)]
            pairs = [(torch.cat([o[:n], f[n - 1 : n]]), a[:n]) for o, f, a, n in rows]
            ends, horizon = terminated.tolist(), rollouts.shape[1]
            return cls.from_episodes(pairs, provenance, task, terminated=ends, horizon=horizon)
        observation = narrowed("observation", wide_tensor(observation, "observation"))
        whence = provenance or Provenance()
        return cls(observation, narrowed("action", action), whence, task)

    # --- files ---------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically: tensors, facts about them, provenance.

        Raises:
            OSError: it cannot be written; the message names the file and says what to do.
            ValueError: these have absorbing states: a file holds what was demonstrated.
        """
        self._check_demonstrated()
        write_demonstrations(
            path,
            self.observation,
            self.action,
            self.task,
            self.provenance,
            self.length,
            self.terminated,
        )

    def _check_demonstrated(self) -> None:
        if self.absorbing:
            raise ValueError(
                "these demonstrations go on in absorbing states after their end; save those that "
                "with_absorbing_states was called on"
            )

    @classmethod
    def load(cls, path: str | Path) -> DemonstrationDataset:
        """Read what :meth:`save` wrote; nothing is unpickled.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: another kind of file, another schema version, a damaged file, tensors that
                are no part of the schema, or contents that :meth:`validate` rejects. The message
                names the file, and the episodes where some are at fault.
        """
        observation, action, task, provenance, length, ended = read_demonstrations(path)
        try:
            return cls(observation, action, provenance, task, length, ended)
        except ValueError as error:
            raise ValueError(f"{expanded(path)}: {error}") from error

    def to_minari(self, dataset_id: str, **described: Any) -> None:
        """Create the local Minari dataset ``dataset_id``; needs ``pip install pemirl-trl[minari]``.

        Args:
            dataset_id: ``(namespace/)(environment/)name-v<version>``.
            described: ``author``, ``author_email``, ``code_permalink``, ... for Minari's metadata.
        """
        self._check_demonstrated()
        metadata = {"provenance": asdict(self.provenance)}
        action = self.action.argmax(-1) if self.discrete else self.action
        choices = self.action_dim if self.discrete else None
        episodes = [
            (o[: n + 1], a[:n])
            for o, a, n in zip(self.observation, action, self.lengths.tolist(), strict=True)
        ]
        ended = (self.ended if self.terminated is None else self.terminated).tolist()
        write_minari(dataset_id, episodes, ended, self.task, metadata, choices=choices, **described)

    @classmethod
    def from_minari(
        cls, dataset_id: str, *, observation_keys: Sequence[str] | None = None
    ) -> DemonstrationDataset:
        """Read a local Minari dataset, written by :meth:`to_minari` or by anyone.

        Args:
            dataset_id: its name; its discrete actions become one-hot.
            observation_keys: of observations that are dictionaries; see :meth:`from_episodes`.

        Raises:
            ImportError: the ``minari`` extra is not installed.
            ValueError: its episodes hold something else than vectors (or choices, as actions), or a
                feature that float32 cannot tell apart.
        """
        episodes, ended, task, metadata, choices = read_minari(dataset_id)
        if metadata is None:
            provenance = Provenance(environment=dataset_id)
        else:
            what = f"the metadata of {dataset_id}"
            stored = check_fields(metadata, {"provenance": dict}, what)["provenance"]
            provenance = parse_provenance(stored, what)
        try:
            differ = any(ended) or len({len(action) for _, action in episodes}) > 1
            return cls.from_episodes(
                episodes,
                provenance,
                task,
                terminated=ended if differ else None,
                discrete_actions=choices,
                observation_keys=observation_keys,
            )
        except ValueError as error:
            raise ValueError(f"{dataset_id}: {error}") from error
