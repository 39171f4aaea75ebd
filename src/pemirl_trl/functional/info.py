"""The mutual information term L_info(theta, psi) = E_{m, tau ~ p_theta(.|m)} log q_psi(m|tau).

Source: Yu, Yu, Finn and Ermon (2019), Equations 7 and 9 and Lemma 2.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def normalized_within_context(log_q: Tensor) -> Tensor:
    r"""Centre log q_psi(m|tau) over the rollouts of each context, in deviations of the batch.

    Early rollouts lie thousands of nats from every demonstration; this is free of that scale.

    Args:
        log_q: ``[M, K]``, in nats.

    Returns:
        ``[M, K]``: mean 0 in each row, pooled deviation 1; zeros if all are equal.

    Raises:
        ValueError: fewer than two rollouts share a context.
    """
    if log_q.shape[1] < 2:
        raise ValueError(
            f"a deviation needs at least 2 rollouts per context, got {log_q.shape[1]}: "
            "raise rollouts_per_context"
        )
    centred = log_q - log_q.mean(1, keepdim=True)
    deviation = (centred.square().sum() / (centred.numel() - log_q.shape[0])).sqrt()
    return centred / deviation.clamp_min(1e-6)


def info_encoder_loss(log_q: Tensor) -> Tensor:
    r"""Negative log-likelihood of the contexts that produced the rollouts, -E log q_psi(m|tau).

    Its gradient is minus Equation 7 of the paper, provided that m is data (detached) and that
    tau comes from the policy.

    Args:
        log_q: log q_psi(m|tau) of each rollout, any shape, in nats.

    Returns:
        A scalar.
    """
    return -log_q.mean()


def info_reward_loss(log_q: Tensor, returns: Tensor, *, normalize: bool = False) -> Tensor:
    r"""A loss whose gradient in theta is an unbiased estimate of minus Lemma 2.

    Lemma 2: grad_theta L_info = E_m Cov_{tau|m}(log q_psi(m|tau), grad_theta R_theta(tau, m)),
    with R_theta the learned return of the rollout. For each m the covariance is the sample
    covariance of its K rollouts, sum_k (log q_k - mean log q) R_k / (K - 1): unbiased for any K
    of 2 or more, because centring one factor centres the product.

    Args:
        log_q: ``[M, K]``; detached here, so no gradient reaches psi.
        returns: R_theta(tau, m), ``[M, K]``, differentiable in theta.
        normalize: divide the centred log q by its deviation over the batch. This rescales the
            estimate by one positive number: the direction of the gradient stays, its size no
            longer grows with the thousands of nats that a rollout far from every demonstration
            costs. An extension of the paper, for stable training.

    Returns:
        A scalar.

    Raises:
        ValueError: the shapes differ, or fewer than two rollouts share a context.
    """
    rollouts = _rollouts_of(log_q, returns)
    if normalize:
        centred = normalized_within_context(log_q).detach()
    else:
        centred = (log_q - log_q.mean(1, keepdim=True)).detach()
    covariance = (centred * returns).sum(1) / (rollouts - 1)
    return -covariance.mean()


def mixed_with_prior(log_q: Tensor, log_prior: Tensor, prior_fraction: float) -> Tensor:
    r"""log((1 - eps) q(m|tau) + eps p(m)), an inference model that is never quite sure.

    A defensive mixture (Hesterberg, 1995, "Weighted Average Importance Sampling and Defensive
    Mixture Distributions", doi:10.1080/00401706.1995.10484303) is still a distribution over m, so
    E log of it still bounds the mutual information from below. But it is bounded below by
    log p(m) + log eps: a rollout that lies thousands of nats from every demonstration counts as one
    that says nothing of m, and no more; and its gradient in psi fades with q's share of the sum.

    Args:
        log_q: log q_psi(m|tau), any shape, in nats.
        log_prior: log p(m), of the same shape.
        prior_fraction: eps, from 0 (q itself) to below 1.

    Raises:
        ValueError: another eps.
    """
    if not 0 <= prior_fraction < 1:
        raise ValueError(f"prior_fraction is {prior_fraction}; expected 0 to below 1")
    if prior_fraction == 0:
        return log_q
    return torch.logaddexp(
        log_q + math.log1p(-prior_fraction), log_prior + math.log(prior_fraction)
    )


def tilted_info_reward_loss(log_q: Tensor, returns: Tensor) -> Tensor:
    r"""A bounded loss with Lemma 2's gradient where the rollouts of a context return the same.

    The rollouts of one context, drawn by the policy, are weighted as if the policy were tilted by
    the reward, w = softmax_k R_theta(tau_k, m), and the weighted log q is to be large:
    -K / (K - 1) E_m sum_k w_k log q_k. Its slope at equal returns is
    -sum_k (log q_k - mean log q) dR_k / (K - 1), that of :func:`info_reward_loss`. Lemma 2's own
    surrogate is linear in R_theta: with a discriminator that is saturated, nothing opposes it, and
    it drives r without end. This one is satisfied once the rollouts that tell of m return a few
    units more than the others: its value is at most max |log q|, and its gradient fades.

    Args:
        log_q: ``[M, K]``, in nats; detached here, so no gradient reaches psi.
        returns: R_theta(tau, m), ``[M, K]``, differentiable in theta; commonly means over time, so
            that "a few units" are units of r per step.

    Returns:
        A scalar.

    Raises:
        ValueError: the shapes differ, or fewer than two rollouts share a context.
    """
    rollouts = _rollouts_of(log_q, returns)
    weighted = (returns.softmax(1) * log_q.detach()).sum(1)
    return -weighted.mean() * rollouts / (rollouts - 1)


def _rollouts_of(log_q: Tensor, returns: Tensor) -> int:
    """K, of what both losses are given."""
    if log_q.shape != returns.shape or log_q.ndim != 2:
        raise ValueError(
            f"expected log_q and returns of one shape [contexts, rollouts], got "
            f"{tuple(log_q.shape)} and {tuple(returns.shape)}"
        )
    if log_q.shape[1] < 2:
        raise ValueError(
            f"a covariance needs at least 2 rollouts per context, got {log_q.shape[1]}: "
            "raise rollouts_per_context"
        )
    return log_q.shape[1]
