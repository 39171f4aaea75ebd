"""One equation, one pure function: tensors in, tensors out, torch alone."""

from pemirl_trl.functional.airl import (
    PolicyReward,
    binary_classification_loss,
    logit_expert,
    policy_reward,
    shaped_reward,
)
from pemirl_trl.functional.categorical import mixed_with_uniform
from pemirl_trl.functional.diagnostics import (
    channel_information,
    dependence_on_context,
    share_between_groups,
)
from pemirl_trl.functional.gaussian import kl_to_standard_normal
from pemirl_trl.functional.info import (
    info_encoder_loss,
    info_reward_loss,
    mixed_with_prior,
    normalized_within_context,
    tilted_info_reward_loss,
)
from pemirl_trl.functional.policy_gradient import discounted_return, standardize, surrogate
from pemirl_trl.functional.regression import ridge_prediction, time_polynomial_features

__all__ = [
    "PolicyReward",
    "binary_classification_loss",
    "channel_information",
    "dependence_on_context",
    "discounted_return",
    "info_encoder_loss",
    "info_reward_loss",
    "kl_to_standard_normal",
    "logit_expert",
    "mixed_with_prior",
    "mixed_with_uniform",
    "normalized_within_context",
    "policy_reward",
    "ridge_prediction",
    "shaped_reward",
    "share_between_groups",
    "standardize",
    "surrogate",
    "tilted_info_reward_loss",
    "time_polynomial_features",
]
