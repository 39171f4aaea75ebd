"""Policy-gradient pieces: return-to-go, standardisation, the importance-weighted surrogate."""

from __future__ import annotations

import torch
from torch import Tensor


def discounted_return(reward: Tensor, gamma: float) -> Tensor:
    r"""Return-to-go within the horizon, G_t = sum_{k >= t} gamma^(k - t) r_k, zero after the end.

    This is the finite-horizon convention of the paper: nothing is bootstrapped at the last step,
    although an episode ends by time alone.

    Args:
        reward: ``[..., T]``.

    Returns:
        ``[..., T]``.
    """
    returns = torch.empty_like(reward)
    running = torch.zeros_like(reward[..., 0])
    for t in range(reward.shape[-1] - 1, -1, -1):
        running = reward[..., t] + gamma * running
        returns[..., t] = running
    return returns


def standardize(values: Tensor, dim: int | None = None, eps: float = 1e-8) -> Tensor:
    """Zero mean and unit deviation along a dimension, or over all elements; constants become 0."""
    centred = values - values.mean(dim, keepdim=True)
    return centred / (centred.square().mean(dim, keepdim=True).sqrt() + eps)


def surrogate(log_prob: Tensor, old_log_prob: Tensor, advantage: Tensor) -> Tensor:
    r"""Importance-weighted advantage, (pi(a|s) / pi_old(a|s)) A, elementwise.

    Its gradient at pi = pi_old is the policy gradient. (Schulman et al., 2015, Equation 14.)
    """
    return (log_prob - old_log_prob).exp() * advantage
