"""Adversarial inverse RL: the shaped reward, its logit, the classification loss, the policy reward.

Sources: Fu, Luo and Levine (2018), "Learning Robust Rewards with Adversarial Inverse
Reinforcement Learning"; Yu, Yu, Finn and Ermon (2019), Section 3.3 and Appendix E.
"""

from __future__ import annotations

from typing import Literal, get_args

import torch
from torch import Tensor
from torch.nn.functional import softplus

PolicyReward = Literal["state", "shaped", "score"]


def shaped_reward(
    reward: Tensor, potential: Tensor, next_potential: Tensor, gamma: float
) -> Tensor:
    r"""Reward plus potential shaping, f = r(s, m) + gamma h(s', m) - h(s, m).

    Along a trajectory the potentials telescope: for gamma = 1, sum_t f = sum_t r + h(s_T) - h(s_0).
    The three tensors share a shape; so does the result. (Yu et al., 2019, Appendix E.1.)
    """
    return reward + gamma * next_potential - potential


def logit_expert(shaped: Tensor, log_prob: Tensor) -> Tensor:
    r"""Log-odds that a transition is the expert's: log D - log(1 - D) = f - log pi(a|s, m).

    D = exp(f) / (exp(f) + pi) is never formed, so nothing overflows or needs an epsilon.
    High means expert. The two tensors share a shape; so does the result.
    """
    return shaped - log_prob


def binary_classification_loss(logit: Tensor, is_expert: Tensor) -> Tensor:
    r"""Cross-entropy of the discriminator, elementwise and exact in the logit.

    -log D = softplus(-logit) where the transition is the expert's, -log(1 - D) = softplus(logit)
    where it is the policy's.

    Args:
        logit: log-odds of "expert", any shape.
        is_expert: same shape, boolean.
    """
    return softplus(torch.where(is_expert, -logit, logit))


def policy_reward(reward: Tensor, shaped: Tensor, log_prob: Tensor, kind: PolicyReward) -> Tensor:
    r"""The reward that the policy maximises; all tensors share a shape.

    - ``"state"``: r(s, m), the disentangled reward alone (the authors' code);
    - ``"shaped"``: f = r + gamma h' - h; entropy is then the policy objective's business;
    - ``"score"``: log D - log(1 - D) = f - log pi, the paper's Equation 2, entropy included.
    """
    if kind == "state":
        return reward
    if kind == "shaped":
        return shaped
    if kind == "score":
        return logit_expert(shaped, log_prob)
    raise ValueError(f"unknown policy reward {kind!r}; choose one of {get_args(PolicyReward)}")
