"""One part of a demonstration is shown, the other imitated: what is common to both is the task."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pemirl_trl.modules.reading import acted_steps

__all__ = ["in_parts"]


def in_parts(
    trajectories: TensorDictBase, share: float, unseen: Tensor | None = None
) -> TensorDictBase:
    """Cut a share of trajectories in two: q sees one part, and the other one is to be imitated.

    A context that was inferred from a whole demonstration may say how that one went, from where it
    began, and imitates it all the same; what was inferred from its beginning helps to imitate its
    end by the task alone, and the other way round. Nobody needs to know which demonstrations are of
    one task: the two parts of one demonstration are.

    A cut lies anywhere in the middle half of the steps that somebody acted in, and which part is
    shown is a toss of a coin. Draws are from torch's global generator.

    Args:
        trajectories: batch size ``[N]``, as a learner reads them; left unchanged.
        share: of them to cut, in [0, 1]; the others are shown whole and imitated whole.
        unseen: the observation ``[S]`` that stands, with an action of 0, where a step is not
            shown, for an encoder that reads all of T. None: ``mask`` of what is shown says it.

    Returns:
        The trajectories with ``shown``, what q sees of each, and a ``mask`` ``[N, T]`` of what is
        imitated.

    Example:
        >>> from pemirl_trl import DemonstrationDataset
        >>> data = DemonstrationDataset(torch.randn(8, 11, 3), torch.randn(8, 10, 1))
        >>> parts = in_parts(data.trajectories(), share=1.0)
        >>> bool((parts["shown", "mask"] ^ parts["mask"]).all())
        True
    """
    observation, action = trajectories["observation"], trajectories["action"]
    valid = trajectories.get("mask", None)
    everything = torch.ones_like(observation[..., 0], dtype=torch.bool)
    valid = everything if valid is None else valid
    acted = acted_steps(trajectories)
    length = (everything if acted is None else acted).sum(1, keepdim=True)  # [N, 1]
    cut = ((0.25 + 0.5 * torch.rand(length.shape)).to(length.device) * length).round().clamp(min=1)
    before = torch.arange(observation.shape[1], device=length.device) < cut
    first = torch.rand(length.shape) < 0.5
    whole = (torch.rand(length.shape) >= share).to(length.device) | (length < 2)
    seen = torch.where(first.to(length.device), before, ~before)
    parts = trajectories.copy()
    parts.set("mask", valid & (~seen | whole))
    seen = valid & (seen | whole)
    shown = trajectories.select("observation", "action").copy()
    if unseen is None:
        shown.set("mask", seen)
    else:
        seen = seen.unsqueeze(-1)
        shown.set("observation", torch.where(seen, observation, unseen))
        shown.set("action", torch.where(seen, action, 0.0))
    return parts.set("shown", shown)
