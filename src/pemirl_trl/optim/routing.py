"""Route a loss to the parameters it is meant for, by name and not by accident."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.optim import Optimizer


def descend(optimizer: Optimizer, loss: Tensor, *, retain_graph: bool = False) -> None:
    """Take one step on ``loss``, touching the gradients of the optimiser's parameters alone.

    Unlike ``loss.backward()``, nothing accumulates in other parameters that the loss happens to
    reach, so the order of updates cannot leak gradients from one network to another.

    Args:
        optimizer: of the parameters that the loss is meant for.
        loss: a scalar.
        retain_graph: whether the loss's graph is needed again.

    Example:
        >>> x = torch.nn.Parameter(torch.ones(1))
        >>> descend(torch.optim.SGD([x], lr=0.5), x.square().sum())
        >>> x.item()
        0.0
    """
    params = [p for group in optimizer.param_groups for p in group["params"]]
    grads = torch.autograd.grad(loss, params, allow_unused=True, retain_graph=retain_graph)
    for parameter, grad in zip(params, grads, strict=True):
        parameter.grad = grad
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)
