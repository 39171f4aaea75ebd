"""Route a loss to the parameters it is meant for, by name and not by accident."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.optim import Optimizer


def descend(optimizer: Optimizer, loss: Tensor, *, retain_graph: bool = False) -> None:
    """One optimiser step on ``loss``, touching the gradients of its own parameters alone.

    Unlike ``loss.backward()``, nothing accumulates in other parameters that the loss happens to
    reach, so the order of updates cannot leak gradients from one network to another.
    """
    params = [p for group in optimizer.param_groups for p in group["params"]]
    grads = torch.autograd.grad(loss, params, allow_unused=True, retain_graph=retain_graph)
    for parameter, grad in zip(params, grads, strict=True):
        parameter.grad = grad
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)
