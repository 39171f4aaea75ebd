"""A set of demonstrations: its schema, its parts, and what learners see of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl.data.entries import is_one_hot
from pemirl_trl.data.lengths import lengthened, steps_after, with_indicator
from pemirl_trl.data.provenance import Provenance
from pemirl_trl.data.validation import check_demonstrations

__all__ = ["DemonstrationSet"]

Index = int | slice | Sequence[int] | Tensor


@dataclass(frozen=True, eq=False)
class DemonstrationSet:
    """The fields of :class:`pemirl_trl.DemonstrationDataset`, which describes them."""

    observation: Tensor
    action: Tensor
    provenance: Provenance = field(default_factory=Provenance)
    task: TensorDictBase | None = None
    length: Tensor | None = None
    terminated: Tensor | None = None
    absorbing: bool = False

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
        check_demonstrations(self.observation, self.action, self.task, self.length, self.terminated)

    def __len__(self) -> int:
        """Return M, the number of demonstrations."""
        return self.action.shape[0]

    @property
    def horizon(self) -> int:
        """T, the number of actions of the longest demonstration, or to which they are padded."""
        return self.action.shape[1]

    @property
    def lengths(self) -> Tensor:
        """``[M]``: how many actions each demonstration has."""
        if self.length is None:
            return torch.full((len(self),), self.horizon, device=self.action.device)
        return self.length

    @property
    def ended(self) -> Tensor:
        """``[M]``: which demonstrations ended by themselves before T."""
        early = self.lengths < self.horizon
        return early if self.terminated is None else early & self.terminated

    @property
    def cut(self) -> Tensor:
        """``[M]``: which demonstrations were cut before T: nobody knows how they went on."""
        return (self.lengths < self.horizon) & ~self.ended

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

    def __getitem__(self, index: Index) -> Self:
        """Return the chosen demonstrations (an int chooses one) as a dataset."""
        rows = self._rows(index)
        return replace(
            self,
            observation=self.observation[rows],
            action=self.action[rows],
            task=None if self.task is None else self.task[rows],
            length=None if self.length is None else self.length[rows],
            terminated=None if self.terminated is None else self.terminated[rows],
        )

    def padded(self, horizon: int) -> Self:
        """Return these demonstrations with padding up to ``horizon`` steps.

        Raises:
            ValueError: one of them is longer.
        """
        if horizon < self.horizon:
            raise ValueError(
                f"got demonstrations of {self.horizon} steps; expected at most {horizon}"
            )
        if horizon == self.horizon:
            return self
        return replace(
            self,
            observation=lengthened(self.observation, horizon + 1, repeat=True),
            action=lengthened(self.action, horizon, repeat=False),
            length=self.lengths,
        )

    def with_absorbing_states(self, horizon: int | None = None) -> Self:
        """Return them with an indicator in the observation, going on to T after their end.

        What ended by itself stays where it ended: every later step begins at the last observation
        with an indicator of 1 (:class:`pemirl_trl.AbsorbingState` does the same to an environment).
        What was cut is masked after its end, in :meth:`trajectories`, as it is here.

        Args:
            horizon: T; None: that of the longest.

        Raises:
            ValueError: one of them is longer.
        """
        if self.absorbing:
            return self.padded(horizon or self.horizon)
        data = self.padded(horizon or self.horizon)
        observation = with_indicator(data.observation, data.lengths, data.ended)
        return replace(
            data,
            observation=observation,
            length=data.lengths,
            terminated=data.ended,
            absorbing=True,
        )

    def trajectories(self, index: Index | None = None) -> TensorDict:
        """Return demonstrations as a learner may see them, in TorchRL's layout.

        Args:
            index: int, slice, list, index tensor or mask; None means all, as views of the dataset.

        Returns:
            TensorDict with batch_size ``[n]`` (not ``[n, T]``: an encoder reduces time) and leaves
            ``observation [n, T, S]``, ``action [n, T, A]``, ``("next", "observation") [n, T, S]``.
            Where some were cut (or ended, and there are no absorbing states): ``mask [n, T]``,
            False for padding. With absorbing states: ``absorbing [n, T]``, True for the steps that
            begin in one.
        """
        rows = slice(None) if index is None else self._rows(index)
        observation, action = self.observation[rows], self.action[rows]
        return TensorDict(
            {
                "observation": observation[:, :-1],
                "action": action,
                "next": {"observation": observation[:, 1:]},
                **{name: flags[rows] for name, flags in self._flags().items()},
            },
            batch_size=[action.shape[0]],
        )

    def _flags(self) -> dict[str, Tensor]:
        """What tells steps apart, ``[M, T]`` each; nothing where all are a demonstrator's."""
        if self.length is None:
            return {}
        after = steps_after(self.length, self.horizon)
        if not self.absorbing:
            return {"mask": ~after} if after.any() else {}
        flags = {"absorbing": after & self.ended.unsqueeze(-1)}
        if self.cut.any():
            flags["mask"] = ~(after & self.cut.unsqueeze(-1))
        return flags

    def tasks(self, index: Index | None = None) -> TensorDictBase:
        """Return ground-truth task parameters with batch_size ``[n]``, for metrics only.

        Raises:
            ValueError: the dataset has none.
        """
        if self.task is None:
            raise ValueError(
                "these demonstrations carry no ground-truth task parameters: from_episodes(..., "
                "task={name: values}) stores them, and from_rollouts what it finds under 'task'"
            )
        return self.task if index is None else self.task[self._rows(index)]

    def _rows(self, index: Index) -> Tensor:
        return torch.arange(len(self), device=self.action.device)[index].reshape(-1)
