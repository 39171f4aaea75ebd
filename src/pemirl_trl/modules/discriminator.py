"""AIRL's discriminator, whose logit is known in closed form."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey

from pemirl_trl.functional import logit_expert
from pemirl_trl.modules.reward import ShapedReward


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

    in_keys: list[NestedKey]
    out_keys: list[NestedKey]

    def __init__(self, reward: ShapedReward, log_prob_key: NestedKey = "action_log_prob") -> None:
        super().__init__()
        self.reward = reward
        self.log_prob_key = log_prob_key
        self.in_keys = [*reward.in_keys, log_prob_key]
        self.out_keys = [*reward.out_keys, "logit_expert"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write r, f and the logit into ``tensordict``."""
        self.reward(tensordict)
        shaped = tensordict[self.reward.out_keys[1]]
        log_prob = tensordict[self.log_prob_key].view_as(shaped)
        return tensordict.set(self.out_keys[-1], logit_expert(shaped, log_prob))
