"""A policy is told which body it has."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

import pemirl_envs
from pemirl_envs import SeveralBodies, TaskEnv
from pemirl_envs.tasks.ant import Ant
from pemirl_trl import TellBody


class TwoAnts(SeveralBodies, Ant):
    def __init__(self):
        Ant.__init__(self)
        self.use_bodies([Ant(), Ant(disabled=(2,))])


def test_the_body_stands_behind_the_observation():
    env = TransformedEnv(TaskEnv(TwoAnts(), 6, seed=0, num_threads=1), TellBody(2))
    check_env_specs(env)
    rollout = env.rollout(2)
    for part in (rollout, rollout["next"]):
        assert torch.equal(part["observation"][..., -2:], part["task", "body"])
    assert rollout["task", "body"].sum(-1).eq(1).all()


def test_a_new_body_is_none_of_them():
    env = TransformedEnv(pemirl_envs.make("ant/disabled", 2, seed=0), TellBody(3))
    check_env_specs(env)
    observation = env.rollout(2)["next", "observation"]
    assert observation.shape == (2, 2, 30)
    assert (observation[..., -3:] == 0).all()


def test_another_number_of_bodies_is_refused():
    seen = TensorDict({"observation": torch.ones(1, 3), "task": {"body": torch.eye(2)[:1]}}, [1])
    with pytest.raises(ValueError, match="has 2 bodies, TellBody was made for 3"):
        TellBody(3)(seen)
