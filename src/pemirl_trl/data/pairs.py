"""Pairs of demonstrations of one task by two bodies: what is common to them is the task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from pemirl_trl.data.demonstration_set import DemonstrationSet

__all__ = ["Pairs", "pair_by_task"]


class Pairs(NamedTuple):
    """Demonstrations, each with another one of its task.

    Attributes:
        trajectories: batch size ``[J]``, as a learner reads them, with an entry ``shown``: the
            other demonstration, which q sees in place of this one.
        rows: ``[J]``, which demonstration each one is, for their ground truth say.
    """

    trajectories: TensorDict
    rows: Tensor


def pair_by_task(
    demonstrations: DemonstrationSet,
    task_of: Sequence[int] | Tensor,
    body_of: Sequence[int] | Tensor,
    *,
    copies: int = 3,
    seed: int = 0,
) -> Pairs:
    """Pair every demonstration with others of the same task by another body.

    Unlabelled demonstrations of several bodies do not say which reward holds in all of them: a
    code m that calls one body's forward the other's backward explains them as well. Whose m was
    inferred from *another* body's demonstration holds what the two have in common, and a reward
    r(s, m) that is to tell one body's demonstrations apart by it cannot read what is a body's own.

    Args:
        demonstrations: M of them, by two or more bodies.
        task_of: ``[M]``, equal numbers for demonstrations of the same task. What the task *is*
            need not be known.
        body_of: ``[M]``, which body each is of. With one body only, every demonstration is paired
            with another one by it: m then holds the task and no chance of a single demonstration.
        copies: how many partners each one gets, drawn with replacement.
        seed: of the draws.

    Raises:
        ValueError: numbers of another length; or a demonstration without partner: its task was
            demonstrated by one body alone. Names the tasks.

    Example:
        >>> import torch
        >>> from pemirl_trl import DemonstrationDataset
        >>> data = DemonstrationDataset(torch.randn(4, 11, 3), torch.randn(4, 10, 1))
        >>> pairs = pair_by_task(data, task_of=[0, 0, 1, 1], body_of=[0, 1, 0, 1], copies=1)
        >>> other = data.trajectories([1, 0, 3, 2])
        >>> bool((pairs.trajectories["shown"] == other).all())
        True
    """
    task, body = torch.as_tensor(task_of), torch.as_tensor(body_of)
    for name, value in (("task_of", task), ("body_of", body)):
        if value.shape != (len(demonstrations),):
            raise ValueError(
                f"{name} has the shape {list(value.shape)}; expected one number for each of "
                f"{len(demonstrations)} demonstrations"
            )
    alike = task.unsqueeze(-1) == task
    same_body = body.unsqueeze(-1) == body
    one_body = bool(same_body.all())
    partner = alike & (~torch.eye(len(task), dtype=torch.bool) if one_body else ~same_body)
    if not partner.any(1).all():
        alone = sorted(set(task[~partner.any(1)].tolist()))
        raise ValueError(
            f"task(s) {alone[:5]} were demonstrated "
            + ("once" if one_body else "by one body alone")
            + "; expected two demonstrations of each task"
            + ("" if one_body else ", by different bodies")
        )
    generator = torch.Generator().manual_seed(seed)
    shown = torch.multinomial(partner.float(), copies, replacement=True, generator=generator)
    rows = torch.arange(len(task)).repeat_interleave(copies)
    trajectories = demonstrations.trajectories(rows)
    trajectories.set("shown", demonstrations.trajectories(shown.flatten()))
    return Pairs(trajectories, rows)
