"""A multilayer perceptron's derivative, applied to vectors from either side.

Source: Pearlmutter (1994), "Fast Exact Multiplication by the Hessian",
https://doi.org/10.1162/neco.1994.6.1.147; Schraudolph (2002), "Fast Curvature Matrix-Vector
Products for Second-Order Gradient Descent", https://doi.org/10.1162/08997660260028683, of which
these are the passes R1 and R1-transposed.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def push_forward(
    inputs: Sequence[Tensor],
    slopes: Sequence[Tensor],
    weights: Sequence[Tensor],
    weight_changes: Sequence[Tensor],
    bias_changes: Sequence[Tensor],
) -> Tensor:
    r"""Compute J v, how the output moves when the parameters move by v.

    With a_l the input of layer l of L and s_l the activation's slope behind it, the change of the
    pre-activation is z'_l = a_l dW_l^T + db_l + a'_l W_l^T, and a'_{l+1} = s_l z'_l; a'_1 = 0.

    Args:
        inputs: of each layer, ``[B, F_l]``.
        slopes: derivative of each activation, ``[B, F_{l+1}]``; one fewer than layers.
        weights: ``[F_{l+1}, F_l]``.
        weight_changes, bias_changes: v, of the shapes of weights and biases.

    Returns:
        ``[B, F_{L+1}]``.
    """
    moved = torch.addmm(bias_changes[0], inputs[0], weight_changes[0].mT)
    rest = zip(inputs[1:], slopes, weights[1:], weight_changes[1:], bias_changes[1:], strict=True)
    for layer_input, slope, weight, weight_change, bias_change in rest:
        own = torch.addmm(bias_change, layer_input, weight_change.mT)
        moved = own.addmm_(moved.mul_(slope), weight.mT)
    return moved


def pull_back(
    inputs: Sequence[Tensor],
    slopes: Sequence[Tensor],
    weights: Sequence[Tensor],
    cotangent: Tensor,
) -> tuple[list[Tensor], list[Tensor]]:
    r"""Compute J^T u, the gradient of u . output in the parameters: back-propagation.

    Args:
        inputs, slopes, weights: as in :func:`push_forward`.
        cotangent: u, ``[B, F_{L+1}]``.

    Returns:
        The parts of the weights and of the biases, layer by layer.
    """
    of_weights, of_biases = [], []
    for layer in reversed(range(len(weights))):
        of_weights.append(cotangent.mT @ inputs[layer])
        of_biases.append(cotangent.sum(0))
        if layer > 0:
            cotangent = (cotangent @ weights[layer]).mul_(slopes[layer - 1])
    return of_weights[::-1], of_biases[::-1]
