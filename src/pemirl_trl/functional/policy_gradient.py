"""Policy-gradient pieces: return-to-go, standardisation, the importance-weighted surrogate."""

from __future__ import annotations

import torch
from torch import Tensor


def discounted_return(reward: Tensor, gamma: float) -> Tensor:
    r"""Compute the return-to-go within the horizon, G_t = sum_{k >= t} gamma^(k - t) r_k.

    It is zero after the end. This is the finite-horizon convention of the paper: nothing is
    bootstrapped at the last step, although an episode ends by time alone. TorchRL's ``reward2go``
    cuts powers of gamma below 1e-7 off, differs in the last bits and takes eight times as long.

    Args:
        reward: ``[..., T]``.
        gamma: discount per step.

    Returns:
        ``[..., T]``, in the reward's units.

    Example:
        >>> discounted_return(torch.tensor([1.0, 1.0, 4.0]), gamma=0.5)
        tensor([2.5000, 3.0000, 4.0000])
    """
    returns = torch.empty_like(reward)
    running = torch.zeros_like(reward[..., 0])
    for t in range(reward.shape[-1] - 1, -1, -1):
        running = reward[..., t] + gamma * running
        returns[..., t] = running
    return returns


def standardize(
    values: Tensor, dim: int | None = None, eps: float = 1e-8, *, mask: Tensor | None = None
) -> Tensor:
    """Shift and scale to zero mean and unit deviation; constants become 0.

    Args:
        values: any shape.
        dim: along which; None: over all elements.
        eps: added to the deviation, in its units.
        mask: of the shape of ``values``: which of them count; the others become 0.

    Returns:
        As ``values``, in deviations.
    """
    if mask is not None:
        weight = mask.to(values.dtype)
        count = weight.sum(dim, keepdim=True).clamp(min=1)
        mean = (weight * values).sum(dim, keepdim=True) / count
        centred = weight * (values - mean)
        deviation = (centred.square().sum(dim, keepdim=True) / count).sqrt()
        return centred / (deviation + eps)
    centred = values - values.mean(dim, keepdim=True)
    return centred / (centred.square().mean(dim, keepdim=True).sqrt() + eps)


def surrogate(log_prob: Tensor, old_log_prob: Tensor, advantage: Tensor) -> Tensor:
    r"""Compute the importance-weighted advantage, (pi(a|s) / pi_old(a|s)) A, elementwise.

    Its gradient at pi = pi_old is the policy gradient. Source: Schulman, Levine, Moritz, Jordan and
    Abbeel (2015), "Trust Region Policy Optimization", arXiv:1502.05477, Equation 14.

    Args:
        log_prob: log pi(a|s), any shape, in nats.
        old_log_prob: log pi_old(a|s), of the same shape.
        advantage: A, of the same shape.

    Returns:
        As ``advantage``.
    """
    return (log_prob - old_log_prob).exp() * advantage
