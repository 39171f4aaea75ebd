"""A wrapped environment gives r(s_t, m), keeps its own reward, and trains others' algorithms."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from sb3_contrib import TRPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env

from pemirl_trl import (
    DemonstrationDataset,
    LearnedRewardVectorWrapper,
    LearnedRewardWrapper,
    ModelConfig,
    PEMIRLModel,
    PortableReward,
    TrainingFamily,
    infer,
    save_reward,
)
from pemirl_trl.adapters.fixed_context import FarFromTraining

M = [0.3, -0.2]
T = 5


class Line(gymnasium.Env):
    """A point on a line that observes where it was and is, in one array that it overwrites."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.state = 0, np.zeros(2)
        self.state[:] = self.np_random.uniform(-0.1, 0.1, 2)
        return self.state, {}

    def step(self, action):
        self.t += 1
        self.state[0] = self.state[1]
        self.state[1] += 0.1 * float(action[0])
        return self.state, 10.0 + self.t, self.t == T, False, {"t": self.t}


class InADictionary(gymnasium.ObservationWrapper):
    """The same under the key ``state``."""

    def __init__(self, env):
        super().__init__(env)
        space = env.observation_space
        self.observation_space = gymnasium.spaces.Dict({"state": space, "image": space})

    def observation(self, observation):
        return {"state": observation, "image": observation + 100}


def reward(observation_dim=2, family=True, **config):
    torch.manual_seed(0)
    model = PEMIRLModel(observation_dim, 1, T, ModelConfig(context_dim=2, **config))
    if family:  # of observations within [-1, 1], with deviations of 1
        rows = torch.stack([-torch.ones(T, observation_dim), torch.ones(T, observation_dim)])
        contexts = torch.tensor([[0.3, -0.2], [0.2, -0.3]])
        model.family = TrainingFamily.fit(contexts, rows, model.standardize.scale)
    return PortableReward.of(model)


def r(states):
    return reward()(np.asarray(states), M).squeeze(-1).numpy()


@pytest.mark.parametrize("key", [None, "state"])
def test_a_step_is_rewarded_by_where_it_started(key):
    inner = Line() if key is None else InADictionary(Line())
    env = LearnedRewardWrapper(inner, reward(), M, observation_key=key)
    observation, _ = env.reset(seed=0)
    state = np.array(observation if key is None else observation[key])
    for t in range(1, T + 1):
        observation, learned, terminated, truncated, info = env.step(np.array([0.5]))
        assert isinstance(learned, float)
        assert learned == pytest.approx(float(r(state)), abs=1e-6)
        assert info == {"t": t, "true_reward": 10.0 + t}
        assert (terminated, truncated) == (t == T, False)
        state = np.array(observation if key is None else observation[key])


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_vector_environment_in_every_autoreset_mode(mode):
    inner = SyncVectorEnv([Line, Line, Line], autoreset_mode=mode)
    env = LearnedRewardVectorWrapper(inner, reward(), M)
    observations, _ = env.reset(seed=0)
    ended = np.zeros(3, dtype=bool)
    for _ in range(2 * T + 1):
        if mode == AutoresetMode.DISABLED and ended.any():
            observations, _ = env.reset(options={"reset_mask": ended})
        before = np.array(observations)
        actions = np.full((3, 1), 0.5, np.float32)
        observations, learned, terminations, _, infos = env.step(actions)
        resetting = ended if mode == AutoresetMode.NEXT_STEP else np.zeros(3, dtype=bool)
        np.testing.assert_allclose(learned, np.where(resetting, 0, r(before)), atol=1e-6)
        own = infos["true_reward"]
        assert own.shape == (3,)
        assert ((own == 0) == resetting).all()
        ended = terminations


def test_a_demonstration_is_read_for_m():
    demonstrations = DemonstrationDataset(torch.randn(1, T + 1, 2), torch.randn(1, T, 1))
    m = infer(reward(), demonstrations).context
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        by_demonstration = LearnedRewardWrapper(Line(), reward(), demonstrations)
    by_m = LearnedRewardWrapper(Line(), reward(), m)
    for env in (by_demonstration, by_m):
        env.reset(seed=1)
    action = np.zeros(1)
    assert by_demonstration.step(action)[1] == by_m.step(action)[1]
    distance = infer(reward(), demonstrations).distance
    assert bool(said) == distance.far


def test_a_file_is_read(tmp_path):
    save_reward(reward(), tmp_path / "r")
    env = LearnedRewardWrapper(Line(), tmp_path / "r", M)
    expected = float(r(env.reset(seed=0)[0]))
    assert env.step(np.zeros(1))[1] == pytest.approx(expected, abs=1e-6)


def test_states_outside_of_training_are_said_once():
    env = LearnedRewardWrapper(Line(), reward(), M)
    env.reset(seed=0)
    env.step(np.array([90.0]))  # to 9: 8 deviations beyond 1
    with pytest.warns(FarFromTraining, match=r"asked 8\.\d training deviations .*component 1"):
        env.step(np.array([0.0]))
    env.step(np.array([0.0]))  # warnings are errors here: it is silent now


def test_what_r_does_not_read_may_be_anywhere():
    env = LearnedRewardWrapper(Line(), reward(reward_features=[0]), M)
    env.reset(seed=0)
    env.step(np.array([90.0]))
    env.step(np.array([0.0]))  # component 1 is far, and r reads component 0, which is not yet
    with pytest.warns(FarFromTraining, match="component 0"):
        env.step(np.array([0.0]))


def test_a_far_demonstration_is_said():
    far = DemonstrationDataset(100 * torch.ones(1, T + 1, 2), torch.zeros(1, T, 1))
    with pytest.warns(FarFromTraining, match="FAR from the training family"):
        LearnedRewardWrapper(Line(), reward(), far)


def vector():
    return SyncVectorEnv([Line, Line])


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: LearnedRewardWrapper(vector(), reward(), M), TypeError, "VectorWrapper"),
        (lambda: LearnedRewardVectorWrapper(Line(), reward(), M), TypeError, "got Line"),
        (lambda: LearnedRewardWrapper(Line(), reward(3), M), ValueError, "learned on 3 numbers"),
        (lambda: LearnedRewardVectorWrapper(vector(), reward(3), M), ValueError, "on 3 numbers"),
        (lambda: LearnedRewardWrapper(Line(), reward(), [1.0]), ValueError, r"or \[2\]"),
        (
            lambda: LearnedRewardWrapper(InADictionary(Line()), reward(), M),
            ValueError,
            r"observes \['image', 'state'\]; got observation_key=None",
        ),
        (
            lambda: LearnedRewardWrapper(Line(), reward(), M, observation_key="x"),
            ValueError,
            "no dictionary",
        ),
        (
            lambda: LearnedRewardWrapper(
                Line(), reward(), DemonstrationDataset(torch.randn(2, 6, 2), torch.randn(2, 5, 1))
            ),
            ValueError,
            "got 2 demonstrations",
        ),
        (lambda: LearnedRewardWrapper(Line(), "nothing", M), FileNotFoundError, "point_maze"),
    ],
)
def test_what_does_not_fit_is_said(make, error, message):
    with pytest.raises(error, match=message):
        make()


# --- Stable-Baselines3 -------------------------------------------------------------------------


class Leftwards(PortableReward):
    """r = -10 s_1: known, so that what is learned from it is known too."""

    def forward(self, observation, m):
        return -10 * torch.as_tensor(observation)[..., 1:]


class Rightwards(Line):
    """Its own reward is the opposite of r."""

    def step(self, action):
        before = float(self.state[1])
        observation, _, terminated, truncated, info = super().step(action)
        return observation.astype(np.float32), before, terminated, truncated, info


def leftwards():
    config = ModelConfig(context_dim=2)
    return LearnedRewardWrapper(Rightwards(), Leftwards.of(PEMIRLModel(2, 1, T, config)), M)


def mean_action(model, states):
    return float(model.predict(np.asarray(states, np.float32), deterministic=True)[0].mean())


def test_stable_baselines_accepts_it():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # its advice on spaces
        check_env(LearnedRewardWrapper(gymnasium.make("Pendulum-v1"), reward(3, False), M))


@pytest.mark.parametrize("algorithm", [TRPO, PPO])
def test_an_on_policy_algorithm_of_theirs_follows_the_learned_reward(algorithm):
    envs = make_vec_env(leftwards, n_envs=4, seed=0)
    model = algorithm("MlpPolicy", envs, n_steps=100, batch_size=100, gamma=0.9, seed=0)
    before = mean_action(model, np.zeros((8, 2)))
    model.learn(2000)
    assert mean_action(model, np.zeros((8, 2))) < min(before, -0.3)  # the own reward asks for more
    assert np.mean([info["r"] for info in model.ep_info_buffer]) > 0  # what SB3 saw is r


def test_their_soft_actor_critic_follows_the_learned_reward():
    model = SAC(
        "MlpPolicy", leftwards(), gamma=0.9, seed=0, learning_starts=50, learning_rate=3e-3,
        ent_coef=0.01, policy_kwargs={"net_arch": [16]},
    )  # fmt: skip
    model.learn(300)
    assert mean_action(model, np.zeros((8, 2))) < -0.5
