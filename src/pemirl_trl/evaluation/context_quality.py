"""What the inferred context tells about the task: a linear probe, fitted where labels are known."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["linear_probe"]


def linear_probe(
    context: Tensor, task: Tensor, unseen_context: Tensor, unseen_task: Tensor
) -> dict[str, float]:
    """Predict task parameters from contexts by least squares, and measure it on unseen ones.

    Labels serve this measure alone: no learner reads them.

    Args:
        context, task: ``[N, D]`` and ``[N, P]``, to fit with.
        unseen_context, unseen_task: ``[M, D]`` and ``[M, P]``, to measure on.

    Returns:
        ``r2``: the explained share of the unseen parameters' variance around the fitted ones' mean,
        1 is perfect; for parameters of -1 and 1 also ``accuracy``: the share whose signs are all
        right.

    Raises:
        ValueError: the unseen tasks are all alike.
    """
    predicted = _affine(unseen_context) @ torch.linalg.lstsq(_affine(context), task).solution
    spread = (unseen_task - task.mean(0)).square().sum()
    if not spread > 0:
        raise ValueError("the unseen tasks are all at the mean: there is no variance to explain")
    error = (predicted - unseen_task).square().sum()
    measures = {"r2": float(1 - error / spread)}
    if ((task.abs() == 1).all() & (unseen_task.abs() == 1).all()).item():
        right = (predicted.sign() == unseen_task).all(-1)
        measures["accuracy"] = float(right.float().mean())
    return measures


def _affine(context: Tensor) -> Tensor:
    return torch.cat([context, torch.ones_like(context[:, :1])], -1)
