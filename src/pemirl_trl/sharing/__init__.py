"""Rewards that leave this library: one file, or a folder as model hubs have it."""

from pemirl_trl.sharing.portable import PortableReward
from pemirl_trl.sharing.reward_file import load_reward, save_reward

__all__ = ["PortableReward", "load_reward", "save_reward"]
