"""A Gaussian policy as a collector calls it: at every step, to draw and to nothing else."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, exploration_type

from pemirl_trl.modules import ContextPolicy
from pemirl_trl.modules.context_encoder import diagonal_normal
from pemirl_trl.modules.model import Policy
from pemirl_trl.modules.reading import read


class GaussianSampler(TensorDictModuleBase):
    """Draws actions of a Gaussian policy, and writes what the policy itself would, bit for bit.

    ``ProbabilisticActor`` asks at each call which distribution, exploration, generator and keys it
    has. With some hundred simulations that costs as much as its network. Where exploration is not
    random, this calls the policy.

    Args:
        policy: whose distribution is the diagonal Gaussian; shared, not copied.
    """

    def __init__(self, policy: ContextPolicy) -> None:
        super().__init__()
        self.policy = policy
        self.in_keys, self.out_keys = list(policy.in_keys), list(policy.out_keys)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``loc``, ``scale``, ``action`` and its log-probability into ``tensordict``."""
        policy = self.policy
        if exploration_type() is not ExplorationType.RANDOM:
            return policy(tensordict)
        observation = read(tensordict, policy.observation_key, "ContextPolicy")
        loc, scale = policy.gaussian(
            observation, read(tensordict, policy.context_key, "ContextPolicy")
        )
        normal = diagonal_normal(loc, scale)
        action = normal.rsample()
        tensordict.set(policy.loc_key, loc).set(policy.scale_key, scale)
        tensordict.set(policy.action_key, action)
        return tensordict.set(policy.log_prob_key, normal.log_prob(action))


def sampler_of(policy: Policy) -> TensorDictModuleBase:
    """What a collector calls for a policy: the policy itself, unless there is a faster way."""
    if type(policy) is ContextPolicy and policy[-1].distribution_class is diagonal_normal:
        return GaussianSampler(policy)
    return policy
