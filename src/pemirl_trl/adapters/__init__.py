"""Learned rewards in other libraries: Gymnasium with whatever trains on it, and LeRobot's form."""

from pemirl_trl.adapters.absorbing_wrapper import AbsorbingStateWrapper
from pemirl_trl.adapters.gymnasium_wrappers import LearnedRewardVectorWrapper, LearnedRewardWrapper
from pemirl_trl.adapters.lerobot_form import BatchReward

__all__ = [
    "AbsorbingStateWrapper",
    "BatchReward",
    "LearnedRewardVectorWrapper",
    "LearnedRewardWrapper",
]
