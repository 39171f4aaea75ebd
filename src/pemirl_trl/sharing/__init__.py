"""What leaves this library: rewards, in a file or a folder as model hubs have it, and policies."""

from pemirl_trl.sharing.policy_file import load_policy, save_policy
from pemirl_trl.sharing.portable import PortableReward
from pemirl_trl.sharing.reward_file import load_reward, save_reward

__all__ = ["PortableReward", "load_policy", "load_reward", "save_policy", "save_reward"]
