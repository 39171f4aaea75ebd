"""Environments in other processes, or one after another: TorchRL's and Gymnasium's batches."""

import functools

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from torchrl.envs import GymWrapper, ParallelEnv, SerialEnv

from pemirl_trl import adapt, meta_train
from pemirl_trl.methods import policy_training

T = 10
FEW = {
    "model": {"context_dim": 2},
    "meta_il": {"steps": 4, "steps_per_iteration": 2},
    "contexts_per_batch": 2,
    "training": {"iterations": 2, "rollouts_per_context": 2},
}
SHORT = {"rollouts": 4, "optimization": {"iterations": 2}, "initial_policy": "fresh"}


class Walk(gymnasium.Env):
    """The toy of conftest.py in Gymnasium's terms, in float64."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position, self.time = 0.1 * self.np_random.standard_normal(1), 0
        return self.position, {}

    def step(self, action):
        self.position = self.position + 0.25 * np.clip(action, -1.0, 1.0)
        self.time += 1
        return self.position, 0.0, False, self.time == T, {}


def wrapped():
    return GymWrapper(Walk(), categorical_action_encoding=True)


def batch(kind, num_envs, seed):
    """So many of them; processes are forked, since a spawned one imports everything anew."""
    makers = [Walk] * num_envs
    match kind:
        case "serial":
            env = SerialEnv(num_envs, wrapped)
        case "parallel":
            env = ParallelEnv(num_envs, wrapped, mp_start_method="fork")
        case "sync":
            return SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED)
        case _:
            mode = AutoresetMode.DISABLED
            return AsyncVectorEnv(makers, autoreset_mode=mode, context="fork")
    env.set_seed(seed)
    return env


def trained(kind, dataset):
    """A model and an adaptation."""
    data = dataset(torch.linspace(-1, 1, 8).unsqueeze(-1))
    make_env = functools.partial(batch, kind)
    model = meta_train(make_env, data, **FEW)
    return model, adapt(model, dataset(torch.tensor([[0.4]])), make_env, **SHORT)


PROCESSES = pytest.param("serial", "parallel", marks=pytest.mark.long)  # 26 rounds of starting them


@pytest.mark.parametrize(("one", "other"), [PROCESSES, ("sync", "async")])
def test_other_processes_train_what_this_one_does(dataset, monkeypatch, one, other):
    """Bit for bit, so that which of the two is a question of speed alone."""
    monkeypatch.setattr(policy_training, "JUDGED_EPISODES", 4)  # one process for each
    (model, adaptation), (same, likewise) = (trained(kind, dataset) for kind in (one, other))
    for name, weights in model.state_dict().items():
        assert weights.dtype == torch.float32
        assert torch.equal(weights, same.state_dict()[name]), name
    assert adaptation.learned_return == likewise.learned_return
    for name, weights in adaptation.policy.state_dict().items():
        assert torch.equal(weights, likewise.policy.state_dict()[name]), name
