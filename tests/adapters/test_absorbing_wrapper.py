"""What ended goes on where it ended in Gymnasium too, as in the demonstrations r was learned on."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env

from pemirl_trl import (
    DemonstrationDataset,
    LearnedRewardVectorWrapper,
    LearnedRewardWrapper,
    ModelConfig,
    PEMIRLModel,
    PortableReward,
)
from pemirl_trl.adapters import AbsorbingStateWrapper

T, M = 8, [0.3, -0.2]


class Line(gymnasium.Env):
    """A point on a line, over once it is beyond 1 or after ``cut`` steps."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    observation_space = gymnasium.spaces.Box(-9.0, 9.0, (2,), np.float32)

    def __init__(self, cut=None):
        self.cut = cut

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.state = 0, np.zeros(2, np.float32)
        return self.state, {}

    def step(self, action):
        self.t += 1
        self.state += np.float32([0.1, action[0]])  # in place, as some simulators do
        return self.state, 10.0 + self.t, bool(self.state[1] > 1.0), self.t == self.cut, {}


class InADictionary(gymnasium.ObservationWrapper):
    def __init__(self, env):
        super().__init__(env)
        self.observation_space = gymnasium.spaces.Dict({"state": env.observation_space})

    def observation(self, observation):
        return {"state": observation}


@pytest.fixture
def reward():
    torch.manual_seed(0)
    return PortableReward.of(PEMIRLModel(3, 1, T, ModelConfig(context_dim=2, absorbing=True)))


def episode(env, key=None):
    """Observations, rewards, own rewards and flags of steps of 0.4 until it is over."""
    first, _ = env.reset(seed=0)
    steps, over = [], False
    while not over:
        observation, r, terminated, truncated, info = env.step(np.float32([0.4]))
        steps.append((observation, r, info["true_reward"], terminated))
        over = terminated or truncated
    observations, *rest = zip(*steps, strict=True)
    seen = [o if key is None else o[key] for o in (first, *observations)]
    return np.array(seen), *map(np.array, rest)


@pytest.mark.parametrize("key", [None, "state"])
def test_it_is_rewarded_as_a_demonstration_of_the_same_steps(reward, key):
    env = Line() if key is None else InADictionary(Line())
    wrapped = LearnedRewardWrapper(env, reward, M, observation_key=key)
    observations, learned, own, terminated = episode(wrapped, key)
    states, actions = observations[:4, :2], np.full((3, 1), 0.4, np.float32)
    demonstration = DemonstrationDataset.from_episodes(
        [(states, actions)], terminated=True, horizon=T
    ).with_absorbing_states()
    assert np.array_equal(observations, demonstration.observation[0])
    expected = reward(demonstration.observation[0, :T], M).squeeze(-1)
    torch.testing.assert_close(torch.tensor(learned), expected.double())
    assert own.tolist() == [11.0, 12.0, 13.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert not terminated.any()


def test_of_a_constant_reward_no_end_is_worth_more(reward):
    for name, parameter in reward.reward.named_parameters():
        parameter.fill_(-2.0 if name == "reward_net.4.bias" else 0.0)
    _, learned, _, _ = episode(LearnedRewardWrapper(Line(), reward, M))
    assert learned.tolist() == [-2.0] * T


def test_what_was_cut_is_over(reward):
    observations, learned, _, _ = episode(LearnedRewardWrapper(Line(cut=2), reward, M))
    assert len(learned) == 2
    assert not observations[:, 2].any()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_vector_environments_of_wrapped_ones(reward, mode):
    def single():
        return AbsorbingStateWrapper(Line(), T)

    envs = LearnedRewardVectorWrapper(SyncVectorEnv([single] * 2, autoreset_mode=mode), reward, M)
    _, expected, _, _ = episode(LearnedRewardWrapper(Line(), reward, M))
    envs.reset(seed=0)
    for t in range(T):
        _, learned, terminated, truncated, _ = envs.step(np.full((2, 1), 0.4, np.float32))
        assert np.allclose(learned, expected[t])
        assert not terminated.any()
        assert (truncated == (t == T - 1)).all()


def test_a_vector_environment_that_would_begin_anew_is_refused(reward):
    message = r"wrap each single one in AbsorbingStateWrapper\(env, 8\)"
    with pytest.raises(ValueError, match=message):
        LearnedRewardVectorWrapper(SyncVectorEnv([Line]), reward, M)


def test_an_environment_of_another_size_is_refused(reward):
    pixels = gymnasium.spaces.Box(0.0, 1.0, (4, 4), np.float32)
    env = Line()
    env.observation_space = pixels
    with pytest.raises(ValueError, match=r"the reward was learned on 3 numbers"):
        LearnedRewardWrapper(env, reward, M)
    with pytest.raises(ValueError, match=r"expected a vector, Box of shape"):
        AbsorbingStateWrapper(env, T)


def test_stable_baselines_accepts_it(reward):
    check_env(LearnedRewardWrapper(Line(), reward, M), warn=False)
