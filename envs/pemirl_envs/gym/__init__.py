"""The gymnasium face: one episode (``gymnasium.make``) or a batch (``gymnasium.make_vec``)."""

from pemirl_envs.gym.registration import check_ids, gym_id, register_tasks
from pemirl_envs.gym.single import GymEnv
from pemirl_envs.gym.vector import GymVectorEnv

__all__ = ["GymEnv", "GymVectorEnv", "check_ids", "gym_id", "register_tasks"]
