"""An environment that a method cannot train on is refused before the first step."""

import pytest
import torch
from torchrl.data import Bounded, Categorical, Composite, OneHot, Unbounded
from torchrl.envs import TransformedEnv

from pemirl_trl import InferContext, meta_train
from pemirl_trl.methods import EpisodeCollector


def collector(problem, env):
    model = problem.model()
    transform = InferContext(model.encoder, problem.demonstrations, rollouts_per_context=2)
    return EpisodeCollector(TransformedEnv(env, transform), model.policy, problem.horizon)


def discrete(env):
    env.action_spec = Categorical(3, shape=(4, 1))


def one_hot(env):
    env.action_spec = OneHot(3, shape=(4, 3))


def two_actions(env):
    env.action_spec = Bounded(-torch.ones(4, 2), torch.ones(4, 2))


def double(env):
    spec = Unbounded((4, 1), dtype=torch.float64)
    env.observation_spec = Composite(observation=spec, shape=[4])


def longer(env):
    env.horizon = 12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            discrete,
            r"its actions are 3 choices \(Categorical\); a Gaussian .*discrete_actions=3",
        ),
        (one_hot, r"its actions are 3 choices \(OneHot\); a Gaussian policy"),
        (two_actions, r"its actions have the shape \[4, 2\]; the policy's are \[4, 1\]"),
        (double, r"'observation' is torch.float64, and the networks take .* \(DoubleToFloat casts"),
        (longer, "its episodes last 12 steps, and the model's 10"),
    ],
)
def test_what_does_not_fit_is_named_with_its_cure(reach, change, message):
    env = reach.make(4)
    change(env)
    with pytest.raises(ValueError, match=message):
        collector(reach, env)


def test_an_observation_of_another_name_is_named(reach):
    env = reach.make(4)
    env.observation_spec = Composite(state=Unbounded((4, 1)), shape=[4])
    with pytest.raises(ValueError, match=r"the policy reads 'observation', and it gives .*'state'"):
        collector(reach, env)


def test_all_that_does_not_fit_is_said_at_once(reach):
    env = reach.make(4)
    discrete(env)
    longer(env)
    with pytest.raises(ValueError, match=r"actions are .*; its episodes last"):
        collector(reach, env)


def test_what_fits_passes(reach):
    assert collector(reach, reach.make(4))().shape == (4, 10)


def test_observations_of_another_type_than_their_spec_says_are_named(make_env, dataset):
    def unsaid(num_envs, seed):
        env = make_env(num_envs, seed)
        observed = env._observed
        env._observed = lambda: observed().update({"observation": env.position.double()})
        return env

    pile = dataset(torch.tensor([[-0.5], [0.5]]))
    with pytest.raises(ValueError, match=r"are torch\.float64, its observation_spec says"):
        meta_train(unsaid, pile)
