"""Adversarial inverse RL: the shaped reward, its logit, the classification loss, the policy reward.

Sources: Fu, Luo and Levine (2018), "Learning Robust Rewards with Adversarial Inverse Reinforcement
Learning", arXiv:1710.11248; Yu, Yu, Finn and Ermon (2019), "Meta-Inverse Reinforcement Learning
with Probabilistic Context Variables", arXiv:1909.09314, Section 3.3 and Appendix E.
"""

from __future__ import annotations

from typing import Literal, get_args

import torch
from torch import Tensor
from torch.nn.functional import softplus

PolicyReward = Literal["state", "shaped", "score"]
"""What the policy maximises, see :func:`policy_reward`."""


def shaped_reward(
    reward: Tensor, potential: Tensor, next_potential: Tensor, gamma: float
) -> Tensor:
    r"""Add the potential's shaping to the reward, f = r(s, m) + gamma h(s', m) - h(s, m).

    Along a trajectory the potentials telescope: for gamma = 1, sum_t f = sum_t r + h(s_T) - h(s_0).
    (Yu et al., 2019, Appendix E.1.)

    Args:
        reward, potential, next_potential: r(s, m), h(s, m) and h(s', m), of one shape.
        gamma: discount per step.

    Returns:
        f, of that shape.
    """
    return reward + gamma * next_potential - potential


def logit_expert(shaped: Tensor, log_prob: Tensor) -> Tensor:
    r"""Compute the log-odds that a transition is the expert's, log D - log(1 - D) = f - log pi.

    D = exp(f) / (exp(f) + pi) is never formed, so nothing overflows or needs an epsilon.
    High means expert. (Fu, Luo and Levine, 2018, Section 4.)

    Args:
        shaped: f(s, a, s', m), any shape.
        log_prob: log pi(a|s, m), of the same shape, in nats.

    Returns:
        The logit, of that shape, in nats.
    """
    return shaped - log_prob


def binary_classification_loss(logit: Tensor, is_expert: Tensor) -> Tensor:
    r"""Compute the discriminator's cross-entropy, elementwise and exact in the logit.

    -log D = softplus(-logit) where the transition is the expert's, -log(1 - D) = softplus(logit)
    where it is the policy's.

    Args:
        logit: log-odds of "expert", any shape.
        is_expert: same shape, boolean.

    Returns:
        The loss, of that shape, in nats.
    """
    return softplus(torch.where(is_expert, -logit, logit))


def policy_reward(reward: Tensor, shaped: Tensor, log_prob: Tensor, kind: PolicyReward) -> Tensor:
    r"""Compute the reward that the policy maximises; all tensors share a shape.

    - ``"state"``: r(s, m), the disentangled reward alone (the authors' code);
    - ``"shaped"``: f = r + gamma h' - h; entropy is then the policy objective's business;
    - ``"score"``: log D - log(1 - D) = f - log pi, the paper's Equation 2, entropy included.

    Args:
        reward, shaped: r and f, of one shape.
        log_prob: log pi(a|s, m), of that shape, in nats.
        kind: which of these.

    Returns:
        The reward, of that shape.

    Raises:
        ValueError: another kind.
    """
    if kind == "state":
        return reward
    if kind == "shaped":
        return shaped
    if kind == "score":
        return logit_expert(shaped, log_prob)
    raise ValueError(f"unknown policy reward {kind!r}; choose one of {get_args(PolicyReward)}")
