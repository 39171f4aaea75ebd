"""Discriminators of expert and policy: AIRL's, whose logit holds a reward, and GAIL's."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import nn

from pemirl_trl.functional import logit_expert
from pemirl_trl.modules.network import RowwiseMLP
from pemirl_trl.modules.reading import REWARD, read
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

    Source: Fu, Luo and Levine (2018), "Learning Robust Rewards with Adversarial Inverse
    Reinforcement Learning", arXiv:1710.11248, with the context of Yu, Yu, Finn and Ermon (2019),
    arXiv:1909.09314.

    Attributes:
        log_prob_key: where log pi stands; :class:`pemirl_trl.DiscriminatorLoss` follows it.
        reward_key, shaped_reward_key, logit_key: where r, f and the logit are written.

    Args:
        reward: the shaped reward f; shared, not copied.
        log_prob_key: where log pi stands, ``policy.log_prob_key`` of the policy that wrote it.

    Raises:
        TypeError: the reward is no :class:`ShapedReward`.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> discriminator = AIRLDiscriminator(ShapedReward(observation_dim=6, context_dim=3))
        >>> batch = TensorDict(
        ...     {
        ...         "observation": torch.randn(4, 6),
        ...         "next": {"observation": torch.randn(4, 6)},
        ...         "context": torch.randn(4, 3),
        ...         "action_log_prob": torch.randn(4),
        ...     },
        ...     [4],
        ... )
        >>> discriminator(batch)[discriminator.logit_key].shape
        torch.Size([4, 1])
    """

    in_keys: list[NestedKey]
    out_keys: list[NestedKey]

    def __init__(self, reward: ShapedReward, log_prob_key: NestedKey = "action_log_prob") -> None:
        REWARD.required(reward, "AIRLDiscriminator")
        super().__init__()
        self.reward = reward
        self.log_prob_key = log_prob_key
        self.reward_key = reward.reward_key
        self.shaped_reward_key = reward.shaped_reward_key
        self.logit_key: NestedKey = "logit_expert"
        self.in_keys = [*self.role_keys.values()]
        self.out_keys = [*reward.out_keys, self.logit_key]

    @property
    def role_keys(self) -> dict[str, NestedKey]:
        """What it reads and where, by the names of :class:`pemirl_trl.DiscriminatorLoss`."""
        return {
            "observation": self.reward.observation_key,
            "next_observation": self.reward.next_observation_key,
            "context": self.reward.context_key,
            "action_log_prob": self.log_prob_key,
        }

    @property
    def standardize(self) -> Standardize:
        """The map of observations."""
        return self.reward.standardize

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write r, f and the logit into ``tensordict``.

        Raises:
            MissingKeyError: the batch lacks one of ``in_keys``.
        """
        # Without it the reward would write r alone, and not f.
        read(tensordict, self.reward.next_observation_key, "AIRLDiscriminator", "next_observation")
        log_prob = read(tensordict, self.log_prob_key, "AIRLDiscriminator", "action_log_prob")
        shaped = self.reward(tensordict)[self.shaped_reward_key]
        return tensordict.set(self.logit_key, logit_expert(shaped, log_prob.view_as(shaped)))


class GAILDiscriminator(TensorDictModuleBase):
    r"""D(s, a) = sigmoid(g(s, a)) with an MLP g and nothing to disentangle.

    Reads ``observation`` ``[..., S]`` and ``action`` ``[..., A]``; writes the logit g as
    ``logit_expert`` and as ``learned_reward``, both ``[..., 1]``: log D - log(1 - D) is the reward
    that imitation maximises.

    Source: Ho and Ermon (2016), "Generative Adversarial Imitation Learning", arXiv:1606.03476. As
    the baseline of Yu, Yu, Finn and Ermon (2019), arXiv:1909.09314, Section 5, it sees no context.

    Attributes:
        observation_key, action_key: what it reads.
        reward_key, logit_key: where the logit is written, under both names.

    Args:
        observation_dim, action_dim: S and A.
        hidden, activation: of g.
        standardize: map of observations; by default none.
    """

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
        self.observation_key: NestedKey = "observation"
        self.action_key: NestedKey = "action"
        self.reward_key: NestedKey = "learned_reward"
        self.logit_key: NestedKey = "logit_expert"
        self.in_keys: list[NestedKey] = [*self.role_keys.values()]
        self.out_keys: list[NestedKey] = [self.reward_key, self.logit_key]
        self.standardize = standardize or Standardize.identity(observation_dim)
        self.net = RowwiseMLP(observation_dim + action_dim, 1, hidden, activation)

    @property
    def role_keys(self) -> dict[str, NestedKey]:
        """What it reads and where, by the names of :class:`pemirl_trl.DiscriminatorLoss`."""
        return {"observation": self.observation_key, "action": self.action_key}

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the logit into ``tensordict``, under both names.

        Raises:
            MissingKeyError: the batch lacks one of ``in_keys``.
        """
        observation = read(tensordict, self.observation_key, "GAILDiscriminator")
        action = read(tensordict, self.action_key, "GAILDiscriminator")
        logit = self.net(self.standardize(observation), action)
        return tensordict.set(self.reward_key, logit).set(self.logit_key, logit)
