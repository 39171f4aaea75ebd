"""Conjugate gradient for a matrix known by its products."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def conjugate_gradient(
    product: Callable[[Tensor], Tensor],
    rhs: Tensor,
    iterations: int = 10,
    tolerance: float = 1e-10,
) -> tuple[Tensor, float]:
    """Solve A x = rhs for a symmetric positive definite A, starting at zero.

    Source: Hestenes and Stiefel (1952), "Methods of Conjugate Gradients for Solving Linear
    Systems", https://doi.org/10.6028/jres.049.044.

    Args:
        product: v -> A v, for vectors of rhs's shape ``[P]``.
        rhs: ``[P]``.
        iterations: at most so many products; P suffice in exact arithmetic.
        tolerance: stop once |residual|^2 falls below this part of |rhs|^2, so that scaling rhs
            scales x.

    Returns:
        x ``[P]`` and the relative residual |rhs - A x| / |rhs| (0 for rhs = 0).
    """
    solution = torch.zeros_like(rhs)
    residual = rhs.clone()
    direction = rhs.clone()
    squared = start = residual @ residual
    for _ in range(iterations):
        if squared <= tolerance * start:
            break
        image = product(direction)
        step = squared / (direction @ image)
        solution = solution + step * direction
        residual = residual - step * image
        previous, squared = squared, residual @ residual
        direction = residual + (squared / previous) * direction
    return solution, float((squared / start).sqrt()) if start > 0 else 0.0
