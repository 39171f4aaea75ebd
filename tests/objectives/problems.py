"""Small networks, and a batch on which every loss can be computed."""

from types import SimpleNamespace

import torch
from tensordict import TensorDict

from pemirl_trl.modules import (
    AIRLDiscriminator,
    ContextEncoder,
    ContextPolicy,
    ContextValue,
    GAILDiscriminator,
    ShapedReward,
    Standardize,
)

M, K, T, S, A, D = 3, 2, 4, 3, 2, 2
N = M * K


def networks():
    """One of each, with a map of observations that is not the identity."""
    standardize = Standardize(torch.randn(S), torch.rand(S) + 0.5)
    reward = ShapedReward(S, D, hidden=(8,), standardize=standardize)
    return SimpleNamespace(
        encoder=ContextEncoder(S, A, D, T, hidden=(8,), standardize=standardize),
        reward=reward,
        discriminator=AIRLDiscriminator(reward),
        gail=GAILDiscriminator(S, A, hidden=(8,), standardize=standardize),
        policy=ContextPolicy(S, A, D, hidden=(8,), standardize=standardize),
        value=ContextValue(S, D, T, hidden=(8,), standardize=standardize),
    )


def rollouts():
    """``[N, T]``, with every key that some loss reads; pi_old is another policy than today's."""
    observation = torch.randn(N, T + 1, S)
    steps = TensorDict(
        {
            "observation": observation[:, :-1],
            "action": torch.randn(N, T, A),
            "context": torch.randn(M, D).repeat_interleave(K, 0).unsqueeze(1).expand(N, T, D),
            "next": {"observation": observation[:, 1:]},
            "is_expert": torch.rand(N, T) < 0.5,
            "advantage": torch.randn(N, T, 1),
            "value_target": torch.randn(N, T, 1),
        },
        [N, T],
    )
    with torch.no_grad():
        old = networks().policy.get_dist(steps)
    steps.update({"loc": old.mean, "scale": old.stddev})
    return steps.set("action_log_prob", old.log_prob(steps["action"]))
