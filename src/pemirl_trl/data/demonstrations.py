"""Expert demonstrations: where they come from, and their files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from numpy.typing import ArrayLike
from tensordict import NestedKey, TensorDictBase

from pemirl_trl.data.conversion import narrowed, wide_tensor
from pemirl_trl.data.d4rl_format import read_d4rl
from pemirl_trl.data.demonstration_file import read_demonstrations, write_demonstrations
from pemirl_trl.data.demonstration_set import DemonstrationSet
from pemirl_trl.data.entries import action_vectors
from pemirl_trl.data.episodes import check_constant, first_episodes, flags_of, pair_of, task_of
from pemirl_trl.data.formats import format_of, located, read_source
from pemirl_trl.data.imitation_format import read_imitation
from pemirl_trl.data.lengths import steps_after
from pemirl_trl.data.lerobot_format import read_lerobot
from pemirl_trl.data.minari_format import minari_folder, read_minari, write_minari
from pemirl_trl.data.provenance import Provenance
from pemirl_trl.data.recording import Recording, source_name
from pemirl_trl.data.validation import stack_episodes

__all__ = ["DemonstrationDataset", "Provenance"]


class DemonstrationDataset(DemonstrationSet):
    """M demonstrations of at most T steps, in no particular order and without labels.

    ============== ============== ==============================================================
    field          shape, dtype   what it is
    ============== ============== ==============================================================
    observation    [M, T+1, S]    float32; the last one is what the last action led to
    action         [M, T, A]      float32; discrete ones are one-hot, of A choices; A is 0 where
                                  actions were not recorded
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
        episodes: Iterable[tuple[ArrayLike | Mapping[str, Any], ArrayLike | None]],
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
            episodes: one pair per demonstration, of one length or of several. None in the place of
                actions: they were not recorded, A is 0. :func:`pemirl_trl.infer` and
                :func:`pemirl_trl.adapt` take such, with an encoder that reads states alone.
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
            FileNotFoundError: it is not on this machine.
            ValueError: its episodes hold something else than vectors (or choices, as actions), or a
                feature that float32 cannot tell apart.
        """
        recording = read_minari(minari_folder(dataset_id))
        return cls._of(recording, dataset_id, None, observation_keys)

    @classmethod
    def from_lerobot(
        cls,
        folder: str | Path,
        *,
        observation_keys: Sequence[str] | None = None,
        terminated: bool | Sequence[bool] | None = None,
    ) -> DemonstrationDataset:
        """Read a LeRobot dataset of format v3 from a local folder; needs ``pemirl-trl[arrow]``.

        What the last action of an episode led to was not recorded: F frames make F observations and
        F - 1 actions. Without an entry ``action`` they are demonstrations without actions.

        Args:
            folder: with ``meta`` and ``data``; videos and images are not read.
            observation_keys: which entries make the observation, in this order, as ``"state"`` or
                ``"observation.state"``; None: the only one that is numbers.
            terminated: as of :meth:`from_episodes`; the format does not say.

        Raises:
            ImportError: the ``arrow`` extra is not installed.
            FileNotFoundError: a part of it is missing.
            ValueError: another version of the format, an entry that is a video or is not there,
                files that contradict each other, or as :meth:`from_episodes`.
        """
        recording = read_lerobot(folder, observation_keys)
        if terminated is not None:
            flags = flags_of(terminated, len(recording.episodes))
            recording = replace(recording, ended=None if flags is None else flags.tolist())
        return cls._of(recording, folder)

    @classmethod
    def from_imitation(
        cls, source: str | Path | Iterable[Any], *, discrete_actions: int | None = None
    ) -> DemonstrationDataset:
        """Read trajectories of the library imitation; rewards and infos are not read.

        Args:
            source: a folder that ``imitation.data.serialize.save`` wrote (needs
                ``pemirl-trl[arrow]``), one of its older ``.npz`` files, or a list of its
                ``Trajectory``: objects with ``obs [L+1, S]``, ``acts [L, A]`` and ``terminal``.
            discrete_actions: as of :meth:`from_episodes`.

        Raises:
            ImportError: a folder, and the ``arrow`` extra is not installed.
            FileNotFoundError: there is no such file or folder.
            ValueError: another layout, a pickle, or as :meth:`from_episodes`.
        """
        return cls._of(read_imitation(source), source, discrete_actions)

    @classmethod
    def from_d4rl(
        cls, source: str | Path | Mapping[str, ArrayLike], *, discrete_actions: int | None = None
    ) -> DemonstrationDataset:
        """Read a dataset in D4RL's layout; rewards are not read.

        Args:
            source: an ``.hdf5`` file (needs ``pemirl-trl[hdf5]``), an ``.npz`` file, or a mapping:
                ``observations [N, S]``, ``actions [N, A]``, ``terminals [N]``, ``timeouts [N]``
                and perhaps ``next_observations [N, S]``. Without the latter the last action of an
                episode is left out, whose result was not recorded; what ended then has its end at
                the last state there is.
            discrete_actions: as of :meth:`from_episodes`.

        Raises:
            ImportError: an ``.hdf5`` file, and the ``hdf5`` extra is not installed.
            FileNotFoundError: there is no such file.
            ValueError: arrays that are missing, of unequal length or reset where no flag says so;
                or as :meth:`from_episodes`.

        Example:
            >>> places, moves = [[0.0], [1.0], [2.0], [9.0], [8.0]], [[1.0]] * 3 + [[-1.0]] * 2
            >>> ends = {"terminals": [0, 0, 1, 0, 0], "timeouts": [0, 0, 0, 0, 1]}
            >>> steps = {"observations": places, "actions": moves, **ends}
            >>> DemonstrationDataset.from_d4rl(steps).lengths
            tensor([2, 1])
        """
        return cls._of(read_d4rl(source), source, discrete_actions)

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
    def load(
        cls,
        path: str | Path,
        *,
        observation_keys: Sequence[str] | None = None,
        discrete_actions: int | None = None,
    ) -> DemonstrationDataset:
        """Read what :meth:`save` wrote, or what others did; nothing is unpickled.

        Args:
            path: a file of :meth:`save`; an ``.npz`` of ``observation [M, T+1, S]`` and ``action
                [M, T, A]`` (with ``length [M]`` and ``terminated [M]``, where episodes differ), or
                of what :meth:`from_imitation` and :meth:`from_d4rl` read; an ``.hdf5`` of the
                latter; the folder of a LeRobot or an imitation dataset; or ``"minari:NAME"``.
            observation_keys: which entries make the observation, where there are several.
            discrete_actions: n, where actions are stored as integers from 0 to n - 1.

        Raises:
            FileNotFoundError: there is no such file or folder.
            ImportError: its format needs an extra that is not installed.
            ValueError: another kind of file, another schema version, a damaged file, tensors that
                are no part of the schema, or contents that :meth:`validate` rejects. The message
                names the file, and the episodes where some are at fault.
        """
        source, path = path, located(path)
        if format_of(path) == "own":
            observation, action, task, provenance, length, ended = read_demonstrations(path)
            try:
                return cls(observation, action, provenance, task, length, ended)
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from error
        recording = read_source(path, observation_keys)
        keys = observation_keys if recording.has_entries else None
        return cls._of(recording, source, discrete_actions, keys)

    @classmethod
    def _of(
        cls,
        recording: Recording,
        source: object,
        discrete_actions: int | None = None,
        observation_keys: Sequence[str] | None = None,
    ) -> DemonstrationDataset:
        """The data set of a recording; errors name its source."""
        ended = recording.ended
        differ = ended is not None and (
            any(ended) or len({len(observation) for observation, _ in recording.episodes}) > 1
        )
        try:
            return cls.from_episodes(
                recording.episodes,
                recording.provenance,
                recording.task,
                terminated=ended if differ else None,
                discrete_actions=discrete_actions or recording.choices,
                observation_keys=observation_keys,
            )
        except ValueError as error:
            raise ValueError(f"{source_name(source)}: {error}") from error

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
