"""The mutual information term L_info(theta, psi) = E_{m, tau ~ p_theta(.|m)} log q_psi(m|tau).

Source: Yu, Yu, Finn and Ermon (2019), Equations 7 and 9 and Lemma 2.
"""

from __future__ import annotations

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
    if log_q.shape != returns.shape or log_q.ndim != 2:
        raise ValueError(
            f"expected log_q and returns of one shape [contexts, rollouts], got "
            f"{tuple(log_q.shape)} and {tuple(returns.shape)}"
        )
    rollouts = log_q.shape[1]
    if rollouts < 2:
        raise ValueError(
            f"a covariance needs at least 2 rollouts per context, got {rollouts}: "
            "raise rollouts_per_context"
        )
    if normalize:
        centred = normalized_within_context(log_q).detach()
    else:
        centred = (log_q - log_q.mean(1, keepdim=True)).detach()
    covariance = (centred * returns).sum(1) / (rollouts - 1)
    return -covariance.mean()
