"""Expert demonstrations: schema, validation, files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from numpy.typing import ArrayLike
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl.data.conversion import narrowed, plain_tensor, task_batch, wide_tensor
from pemirl_trl.data.demonstration_file import read_demonstrations, write_demonstrations
from pemirl_trl.data.entries import action_vectors, is_one_hot, observation_vectors
from pemirl_trl.data.minari_format import read_minari, write_minari
from pemirl_trl.data.provenance import Provenance, parse_provenance
from pemirl_trl.data.validation import check_demonstrations, stack_episodes
from pemirl_trl.files import check_fields, expanded

__all__ = ["DemonstrationDataset", "Provenance"]

Index = int | slice | Sequence[int] | Tensor


@dataclass(frozen=True, eq=False)
class DemonstrationDataset:
    """M demonstrations with one fixed horizon T, in no particular order and without labels.

    ============== ============== ==============================================================
    field          shape, dtype   what it is
    ============== ============== ==============================================================
    observation    [M, T+1, S]    float32; the last one is what the last action led to
    action         [M, T, A]      float32; discrete ones are one-hot, of A choices
    provenance                    :class:`Provenance`
    task           batch_size [M] ground-truth task parameters, or None. For metrics only: they
                                  never enter :meth:`trajectories`, so no learner sees them.
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

    observation: Tensor
    action: Tensor
    provenance: Provenance = field(default_factory=Provenance)
    task: TensorDictBase | None = None

    def __post_init__(self) -> None:
        for name in ("observation", "action", "task"):
            value = getattr(self, name)
            if getattr(value, "requires_grad", False):
                object.__setattr__(self, name, value.detach())
        self.validate()

    def validate(self) -> None:
        """Check the schema above.

        Raises:
            ValueError: NaN or infinity, an off-by-one, wrong dimensions or dtypes; where a single
                episode is at fault, the message names it.
        """
        check_demonstrations(self.observation, self.action, self.task)

    def __len__(self) -> int:
        """Return M, the number of demonstrations."""
        return self.action.shape[0]

    @property
    def horizon(self) -> int:
        """T, the number of actions of every demonstration."""
        return self.action.shape[1]

    @property
    def observation_dim(self) -> int:
        """Dimension S of an observation."""
        return self.observation.shape[2]

    @property
    def action_dim(self) -> int:
        """Dimension A of an action."""
        return self.action.shape[2]

    @property
    def discrete(self) -> bool:
        """Whether actions are choices: all of them one-hot."""
        return is_one_hot(self.action)

    def __getitem__(self, index: Index) -> DemonstrationDataset:
        """Return the chosen demonstrations (an int chooses one) as a dataset."""
        rows = self._rows(index)
        task = None if self.task is None else self.task[rows]
        return DemonstrationDataset(
            self.observation[rows], self.action[rows], self.provenance, task
        )

    def trajectories(self, index: Index | None = None) -> TensorDict:
        """Return demonstrations as a learner may see them, in TorchRL's layout.

        Args:
            index: int, slice, list, index tensor or mask; None means all, as views of the dataset.

        Returns:
            TensorDict with batch_size ``[n]`` (not ``[n, T]``: an encoder reduces time) and leaves
            ``observation [n, T, S]``, ``action [n, T, A]``, ``("next", "observation") [n, T, S]``.
        """
        rows = slice(None) if index is None else self._rows(index)
        observation, action = self.observation[rows], self.action[rows]
        return TensorDict(
            {
                "observation": observation[:, :-1],
                "action": action,
                "next": {"observation": observation[:, 1:]},
            },
            batch_size=[action.shape[0]],
        )

    def tasks(self, index: Index | None = None) -> TensorDictBase:
        """Return ground-truth task parameters with batch_size ``[n]``, for metrics only.

        Raises:
            ValueError: the dataset has none.
        """
        if self.task is None:
            raise ValueError("these demonstrations carry no ground-truth task parameters")
        return self.task if index is None else self.task[self._rows(index)]

    def _rows(self, index: Index) -> Tensor:
        return torch.arange(len(self), device=self.action.device)[index].reshape(-1)

    # --- from elsewhere ------------------------------------------------------------------------

    @classmethod
    def from_episodes(
        cls,
        episodes: Iterable[tuple[ArrayLike | Mapping[str, Any], ArrayLike]],
        provenance: Provenance | None = None,
        task: Mapping[str, ArrayLike] | TensorDictBase | None = None,
        *,
        discrete_actions: int | None = None,
        observation_keys: Sequence[str] | None = None,
    ) -> DemonstrationDataset:
        """Build a dataset of ``(observation [T+1, S], action [T, A])`` pairs of arrays or tensors.

        Args:
            episodes: one pair per demonstration, all of one horizon.
            provenance: where they come from.
            task: ground truth, a mapping of name to ``[M, ...]``.
            discrete_actions: n, where actions are integers ``[T]`` from 0 to n - 1.
            observation_keys: which entries of observations that are mappings of arrays
                ``[T+1, ...]`` make the vector, in this order; ``"arm.angle"`` is nested.

        Raises:
            ValueError: mixed horizons or dimensions, an off-by-one, NaN, something else than real
                numbers, actions or entries that are not there, or a feature that float32 cannot
                tell apart; the episodes are named.

        Example:
            >>> walk = {"place": [[0], [1], [2]], "speed": [[0], [1], [1]]}, [2, 0]
            >>> data = DemonstrationDataset.from_episodes(
            ...     [walk], discrete_actions=3, observation_keys=["speed", "place"]
            ... )
            >>> data.observation[0, 2], data.action[0, 0], data.discrete
            (tensor([1., 2.]), tensor([0., 0., 1.]), True)
        """
        pairs = [
            _pair(i, episode, discrete_actions, observation_keys)
            for i, episode in enumerate(episodes)
        ]
        observation, action = stack_episodes(pairs)
        return cls(
            narrowed("observation", observation),
            narrowed("action", action),
            provenance or Provenance(),
            _task(task, len(pairs)),
        )

    @classmethod
    def from_rollouts(
        cls,
        rollouts: TensorDictBase,
        provenance: Provenance,
        task_key: NestedKey | None = "task",
        *,
        discrete_actions: int | None = None,
    ) -> DemonstrationDataset:
        """Build a dataset of whole episodes collected by TorchRL.

        Args:
            rollouts: batch_size ``[M, T]`` with ``observation``, ``action``,
                ``("next", "observation")`` and, under ``task_key``, task parameters that are
                constant in time (their absence makes a dataset without ground truth).
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
        _check_constant("were reset on the way", observation[:, 1:], following[:, :-1])
        task = None if task_key is None else rollouts.get(task_key, None)
        if task is not None:
            for value in task.values(include_nested=True, leaves_only=True):
                _check_constant("changed their task on the way", value[:, 1:], value[:, :-1])
            task = task[:, 0].clone()
        observation = torch.cat([observation, following[:, -1:]], dim=1)  # [M, T+1, S]
        action = action_vectors(rollouts["action"], discrete_actions, "action", leading=2)
        observation = narrowed("observation", wide_tensor(observation, "observation"))
        return cls(observation, narrowed("action", action), provenance, task)

    # --- files ---------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically: tensors, facts about them, provenance.

        Raises:
            OSError: it cannot be written; the message names the file and says what to do.
        """
        write_demonstrations(path, self.observation, self.action, self.task, self.provenance)

    @classmethod
    def load(cls, path: str | Path) -> DemonstrationDataset:
        """Read what :meth:`save` wrote; nothing is unpickled.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: another kind of file, another schema version, a damaged file, tensors that
                are no part of the schema, or contents that :meth:`validate` rejects. The message
                names the file, and the episodes where some are at fault.
        """
        observation, action, task, provenance = read_demonstrations(path)
        try:
            return cls(observation, action, provenance, task)
        except ValueError as error:
            raise ValueError(f"{expanded(path)}: {error}") from error

    def to_minari(self, dataset_id: str, **described: Any) -> None:
        """Create the local Minari dataset ``dataset_id``; needs ``pip install pemirl-trl[minari]``.

        Args:
            dataset_id: ``(namespace/)(environment/)name-v<version>``.
            described: ``author``, ``author_email``, ``code_permalink``, ... for Minari's metadata.
        """
        metadata = {"provenance": asdict(self.provenance)}
        action = self.action.argmax(-1) if self.discrete else self.action
        choices = self.action_dim if self.discrete else None
        write_minari(
            dataset_id, self.observation, action, self.task, metadata, choices=choices, **described
        )

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
            ValueError: its episodes do not share one horizon, hold something else than vectors (or
                choices, as actions), or a feature that float32 cannot tell apart.
        """
        episodes, task, metadata, choices = read_minari(dataset_id)
        if metadata is None:
            provenance = Provenance(environment=dataset_id)
        else:
            what = f"the metadata of {dataset_id}"
            stored = check_fields(metadata, {"provenance": dict}, what)["provenance"]
            provenance = parse_provenance(stored, what)
        try:
            return cls.from_episodes(
                episodes,
                provenance,
                task,
                discrete_actions=choices,
                observation_keys=observation_keys,
            )
        except ValueError as error:
            raise ValueError(f"{dataset_id}: {error}") from error


def _check_constant(what: str, later: Tensor, earlier: Tensor) -> None:
    bad = (later != earlier).flatten(1).any(1).nonzero().flatten().tolist()
    if bad:
        raise ValueError(f"episodes {bad[:5]} {what}; expected one whole episode per row")


def _pair(
    index: int, episode: Any, choices: int | None, keys: Sequence[str] | None
) -> tuple[Tensor, Tensor]:
    try:
        observation, action = episode
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"episode {index} is a {type(episode).__name__}; expected a pair (observation, action)"
        ) from error
    return (
        observation_vectors(observation, keys, f"episode {index}: observation"),
        action_vectors(action, choices, f"episode {index}: action"),
    )


def _task(
    task: Mapping[str, ArrayLike] | TensorDictBase | None, episodes: int
) -> TensorDictBase | None:
    if task is None or isinstance(task, TensorDictBase):
        return task
    values = {name: plain_tensor(value, f"task entry {name!r}") for name, value in task.items()}
    return task_batch(values, episodes)
