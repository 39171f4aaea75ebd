"""A Gaussian policy as a collector calls it: at every step, to draw and to nothing else."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, exploration_type

from pemirl_trl.modules import ContextPolicy
from pemirl_trl.modules.context_encoder import diagonal_normal
from pemirl_trl.modules.model import Policy
from pemirl_trl.modules.reading import read


class GaussianSampler(TensorDictModuleBase):
    """Draws actions of a Gaussian policy step by step, and writes the rest for all steps at once.

    What a draw and :meth:`complete` write is what the policy itself would, bit for bit.
    ``ProbabilisticActor`` asks at each call which distribution, exploration, generator and keys it
    has. With some hundred simulations that costs more than its network, and so do densities that
    nobody reads before the rollouts are whole. Where exploration is not random, this calls the
    policy.

    Args:
        policy: whose distribution is the diagonal Gaussian; shared, not copied.
    """

    def __init__(self, policy: ContextPolicy) -> None:
        super().__init__()
        self.policy = policy
        self.in_keys = list(policy.in_keys)
        self.out_keys = [policy.loc_key, policy.action_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``loc`` and a drawn ``action`` into ``tensordict``."""
        policy = self.policy
        if exploration_type() is not ExplorationType.RANDOM:
            return policy(tensordict)
        loc, scale = policy.gaussian(
            read(tensordict, policy.observation_key, "ContextPolicy"),
            read(tensordict, policy.context_key, "ContextPolicy"),
        )
        action = torch.randn_like(loc).mul_(scale).add_(loc)
        return tensordict.set(policy.loc_key, loc).set(policy.action_key, action)

    @torch.no_grad()
    def complete(self, rollouts: TensorDictBase) -> None:
        """Write ``scale`` and the actions' log-probability into what was drawn."""
        policy, loc = self.policy, rollouts[self.policy.loc_key]
        scale = policy.log_scale.exp().expand_as(loc)
        log_prob = diagonal_normal(loc, scale).log_prob(rollouts[policy.action_key])
        rollouts.set(policy.scale_key, scale).set(policy.log_prob_key, log_prob)


def sampler_of(policy: Policy) -> GaussianSampler | Policy:
    """What a collector calls for a policy: the policy itself, unless there is a faster way."""
    if type(policy) is ContextPolicy and policy[-1].distribution_class is diagonal_normal:
        return GaussianSampler(policy)
    return policy
