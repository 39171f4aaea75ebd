"""The linear baseline of finite-horizon policy gradients, in closed form and batched.

Source: Duan, Chen, Houthooft, Schulman and Abbeel (2016), "Benchmarking Deep Reinforcement Learning
for Continuous Control", arXiv:1604.06778.
"""

from __future__ import annotations

import torch
from torch import Tensor


def time_polynomial_features(observation: Tensor) -> Tensor:
    """Compute (s, s^2, t, t^2, t^3, 1) with t in [0, 1) along the second-last dimension.

    Args:
        observation: ``[..., T, S]``, of order one: standardise it first.

    Returns:
        ``[..., T, 2 S + 4]``.
    """
    horizon = observation.shape[-2]
    t = torch.arange(horizon, dtype=observation.dtype, device=observation.device) / horizon
    powers = torch.stack([t, t**2, t**3, torch.ones_like(t)], -1)
    powers = powers.expand(*observation.shape[:-1], 4)
    return torch.cat([observation, observation.square(), powers], -1)


def ridge_prediction(
    features: Tensor, target: Tensor, ridge: float = 1e-5, *, mask: Tensor | None = None
) -> Tensor:
    r"""Fit w = (X'X + ridge B I)^-1 X'y for each problem of a batch, and return X w.

    Args:
        features: ``[M, B, F]``, M problems of B rows.
        target: ``[M, B]``.
        ridge: penalty per row; keeps the system regular where features coincide.
        mask: ``[M, B]``, the rows that are fitted to; the prediction is of all.

    Returns:
        ``[M, B]``.
    """
    fitted = features if mask is None else features * mask.unsqueeze(-1).to(features.dtype)
    gram = fitted.mT @ features
    penalty = ridge * features.shape[1] * torch.eye(gram.shape[-1]).to(gram)
    moment = fitted.mT @ target.unsqueeze(-1)
    weights = torch.linalg.solve(gram + penalty, moment)
    return (features @ weights).squeeze(-1)
