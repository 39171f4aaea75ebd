"""The policy half of the discriminator's data: rollouts of the last iterations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

__all__ = ["NEGATIVE_KEYS", "Negatives", "gather_steps"]

NEGATIVE_KEYS: tuple[NestedKey, ...] = (
    "observation",
    "action",
    ("next", "observation"),
    "context",
    "action_log_prob",
)
"""What is kept of a rollout: all that a discriminator and its batches read."""


def gather_steps(trajectories: TensorDictBase, rows: Tensor, times: Tensor) -> TensorDict:
    """Gather single time steps of chosen trajectories.

    Args:
        trajectories: batch_size ``[N]`` or ``[N, T]``, every leaf ``[N, T, ...]``.
        rows: ``[n]`` which trajectories.
        times: ``[n, steps]`` which of their time steps.

    Returns:
        TensorDict with batch_size ``[n, steps]``; nothing but these steps is read.
    """
    picked = {
        key: leaf[rows[:, None], times]
        for key, leaf in trajectories.items(include_nested=True, leaves_only=True)
    }
    return TensorDict(picked, batch_size=times.shape)


class Negatives:
    """Rollouts of the last iterations, each with its own ``context`` and ``action_log_prob``.

    The paper keeps the last 20 iterations. Memory is allocated once, at the first :meth:`add`, and
    then written in place.

    Args:
        capacity: How many iterations to keep.
        keys: What to keep of a rollout.
    """

    def __init__(self, capacity: int = 20, *, keys: Sequence[NestedKey] = NEGATIVE_KEYS) -> None:
        if capacity < 1:
            raise ValueError(f"capacity is {capacity}; expected at least 1 iteration")
        self.capacity = capacity
        self.keys = tuple(keys)
        self._added = 0
        self._device = torch.device("cpu")
        self._ring: TensorDictBase | None = None  # [capacity, N, T], slot = iteration % capacity

    def __len__(self) -> int:
        """Return the number of iterations held."""
        return min(self._added, self.capacity)

    def add(self, rollouts: TensorDictBase) -> None:
        """Keep one iteration's rollouts, in the place of the oldest if full.

        Args:
            rollouts: batch_size ``[N, T]``, the same N and T every time; what is held is on their
                device.

        Raises:
            ValueError: another N or T than before, or a key is missing.
        """
        missing = [key for key in self.keys if rollouts.get(key, None) is None]
        if missing or rollouts.ndim != 2:
            raise ValueError(
                f"rollouts have batch_size {list(rollouts.shape)} and lack {missing}; "
                f"expected [N, T] with {list(self.keys)}"
            )
        kept = rollouts.select(*self.keys).detach()
        self._device = rollouts.get(self.keys[0]).device
        if self._ring is None:
            self._ring = torch.empty_like(kept.expand(self.capacity, *kept.shape))
        elif self._ring.get(self.keys[0]).device != self._device:  # a checkpoint's is on the CPU
            self._ring = self._ring.to(self._device)
        if kept.shape != self._ring.shape[1:]:
            raise ValueError(
                f"rollouts have batch_size {list(kept.shape)}; "
                f"expected {list(self._ring.shape[1:])} as before"
            )
        self._ring[self._added % self.capacity] = kept
        self._added += 1

    def sample(
        self,
        n: int,
        *,
        steps: int | None = None,
        last: int | None = None,
        lengths: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> TensorDict:
        """Draw trajectories uniformly, with replacement, from the last iterations.

        Args:
            n: How many trajectories.
            steps: How many time steps of each, drawn uniformly with replacement; None: all T.
            last: From how many iterations back, at most ``capacity``; None: all that are held.
            lengths: ``[n]``: of how many of its first steps ``steps`` are drawn; None: of all T.
            generator: on the CPU; None means torch's global one.

        Returns:
            TensorDict ``[n, T]``, or ``[n, steps]``.

        Raises:
            ValueError: nothing was added yet, or ``last`` is out of range.
        """
        if self._ring is None:
            raise ValueError("no rollouts yet; expected add() before sample()")
        if last is not None and not 1 <= last <= self.capacity:
            raise ValueError(f"last is {last}; expected 1 to {self.capacity} (the capacity)")
        held = len(self) if last is None else min(last, len(self))
        rollouts, horizon = self._ring.shape[1:]
        drawn = torch.randint(held * rollouts, (n,), generator=generator)
        slot = (self._added - 1 - drawn // rollouts) % self.capacity
        rows = (slot * rollouts + drawn % rollouts).to(self._device)
        flat = self._ring.reshape(-1, horizon)  # a view: [capacity * N, T]
        if steps is None:
            return flat[rows]
        times = torch.randint(horizon, (n, steps), generator=generator).to(self._device)
        if lengths is not None:
            shares = torch.rand((n, steps), generator=generator).to(self._device)
            times = (shares * lengths.unsqueeze(-1)).long()
        return gather_steps(flat, rows, times)

    def state_dict(self) -> dict[str, Tensor]:
        """Return what is held, oldest iteration first: ``name -> [held, N, T, ...]``."""
        if self._ring is None:
            return {}
        oldest = self._added - len(self)
        order = torch.arange(oldest, self._added) % self.capacity
        return dict(self._ring[order].flatten_keys(".").items())

    def load_state_dict(self, state_dict: Mapping[str, Tensor]) -> None:
        """Take that back; with a smaller capacity, the oldest iterations fall out."""
        self._added, self._ring = 0, None
        if not state_dict:
            return
        shape = next(iter(state_dict.values())).shape[:3]
        for rollouts in TensorDict(dict(state_dict), batch_size=shape).unflatten_keys("."):
            self.add(rollouts)
