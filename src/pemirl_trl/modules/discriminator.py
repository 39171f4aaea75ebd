"""Discriminators of expert and policy: AIRL's, whose logit holds a reward, and GAIL's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import nn
from torchrl.modules import MLP

from pemirl_trl.functional import logit_expert
from pemirl_trl.modules.reward import ShapedReward
from pemirl_trl.modules.standardize import Standardize


class AIRLDiscriminator(TensorDictModuleBase):
    r"""D(s, a, m) = sigmoid(f(s, a, s', m) - log pi(a|s, m)), given by its logit.

    Reads the reward's keys and ``action_log_prob`` ``[...]``; writes the reward's keys and
    ``logit_expert`` ``[..., 1]`` (high means expert).

    Which log pi: for a policy transition, the density under the policy *that drew it*, stored at
    collection; for an expert transition, the density under the current policy. The optimal
    discriminator against a mixture of past policies needs the mixture's density, of which the
    stored one is a one-sample estimate; today's policy may put next to no density on an action of
    twenty iterations ago, and its logarithm would then rule the loss.

    Args:
        reward: the shaped reward f; shared, not copied.
        log_prob_key: where log pi stands.
    """

    roles: ClassVar[tuple[str, ...]] = (
        "observation",
        "next_observation",
        "context",
        "action_log_prob",
    )
    """What each of ``in_keys`` is, by the names of :class:`pemirl_trl.DiscriminatorLoss`."""

    in_keys: list[NestedKey]
    out_keys: list[NestedKey]

    def __init__(self, reward: ShapedReward, log_prob_key: NestedKey = "action_log_prob") -> None:
        super().__init__()
        self.reward = reward
        self.log_prob_key = log_prob_key
        self.in_keys = [*reward.in_keys, log_prob_key]
        self.out_keys = [*reward.out_keys, "logit_expert"]

    @property
    def standardize(self) -> Standardize:
        """The map of observations."""
        return self.reward.standardize

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write r, f and the logit into ``tensordict``."""
        self.reward(tensordict)
        shaped = tensordict[self.reward.out_keys[1]]
        log_prob = tensordict[self.log_prob_key].view_as(shaped)
        return tensordict.set(self.out_keys[-1], logit_expert(shaped, log_prob))


class GAILDiscriminator(TensorDictModuleBase):
    r"""D(s, a) = sigmoid(g(s, a)) with an MLP g and nothing to disentangle.

    Reads ``observation`` ``[..., S]`` and ``action`` ``[..., A]``; writes the logit g as
    ``logit_expert`` and as ``learned_reward``, both ``[..., 1]``: log D - log(1 - D) is the reward
    that imitation maximises. (Ho and Ermon, 2016; as the baseline of Yu et al., 2019, Section 5,
    it sees no context.)

    Args:
        observation_dim, action_dim: S and A.
        hidden, activation: of g.
        standardize: map of observations; by default none.
    """

    roles: ClassVar[tuple[str, ...]] = ("observation", "action")

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        hidden: Sequence[int] = (32, 32),
        activation: type[nn.Module] = nn.ReLU,
        standardize: Standardize | None = None,
    ) -> None:
        super().__init__()
        self.in_keys: list[NestedKey] = ["observation", "action"]
        self.out_keys: list[NestedKey] = ["learned_reward", "logit_expert"]
        self.standardize = standardize or Standardize.identity(observation_dim)
        self.net = MLP(
            in_features=observation_dim + action_dim,
            out_features=1,
            num_cells=list(hidden),
            activation_class=activation,
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the logit into ``tensordict``, under both names."""
        observation, action = (tensordict[key] for key in self.in_keys)
        logit = self.net(self.standardize(observation), action)
        for key in self.out_keys:
            tensordict.set(key, logit)
        return tensordict
