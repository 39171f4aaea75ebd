"""Environments as users have them: taken as they are, given a time limit, or refused."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import StepCounter, TransformedEnv

from pemirl_trl import InferContext, infer, meta_train, wrap_gymnasium
from pemirl_trl.methods import EpisodeCollector
from pemirl_trl.methods.environments import Episodes

T = 10


class Walk(gymnasium.Env):
    """The toy of conftest.py in Gymnasium's terms: float64, an end by time if so told."""

    def __init__(self, limit=None, early=False, observed="observation"):
        box = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)
        self.observation_space = box
        if observed != "observation":
            self.observation_space = gymnasium.spaces.Dict({observed: box, "clock": box})
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)
        self.limit, self.early, self.observed = limit, early, observed

    def observe(self):
        at = self.position.copy()
        return at if self.observed == "observation" else {self.observed: at, "clock": at}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position, self.time = 0.1 * self.np_random.standard_normal(1), 0
        return self.observe(), {}

    def step(self, action):
        self.position = self.position + 0.25 * np.clip(action, -1.0, 1.0)
        self.time += 1
        terminated = self.early and self.time == 4
        return self.observe(), 0.0, terminated, self.time == self.limit, {}


def vector(num_envs, mode=AutoresetMode.DISABLED, **options):
    return SyncVectorEnv([lambda: Walk(**options)] * num_envs, autoreset_mode=mode)


@pytest.fixture
def episodes(reach, dataset):
    def episodes(make_env):
        return Episodes(make_env, reach.model(), dataset(torch.linspace(-1, 1, 4).unsqueeze(-1)))

    return episodes


def rollouts(reach, episodes, num_envs=4, seed=0):
    model = reach.model()
    infer = InferContext(model.encoder, reach.demonstrations, rollouts_per_context=2)
    collect = EpisodeCollector(episodes(num_envs, seed, infer), model.policy, T)
    collect()
    return collect()


@pytest.mark.parametrize(
    "make_env",
    [
        lambda n, seed: vector(n, limit=T),
        lambda n, seed: vector(n),
        lambda n, seed: vector(n, AutoresetMode.SAME_STEP, limit=T),
        lambda n, seed: Walk(limit=T),
        lambda n, seed: Walk(),
        lambda n, seed: wrap_gymnasium(vector(n, observed="position"), "position"),
    ],
    ids=["vector", "no limit", "same step", "single", "single without limit", "dictionary"],
)
def test_gymnasium_environments_give_whole_episodes_of_float32(reach, episodes, make_env):
    batch = rollouts(reach, episodes(make_env))
    assert batch.shape == (4, T)
    done = batch["next", "done"].squeeze(-1)
    assert done[:, -1].all()
    assert not done[:, :-1].any()
    assert batch["observation"].dtype == torch.float32
    # The last observation is the episode's own, not the next one's first.
    moved = (batch["next", "observation"] - batch["observation"]).squeeze(-1)
    expected = 0.25 * batch["action"].clamp(-1, 1).squeeze(-1)
    torch.testing.assert_close(moved, expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(batch["observation"][:, 1:], batch["next", "observation"][:, :-1])


def test_a_vector_environment_follows_its_seed(reach, episodes):
    made = episodes(lambda n, seed: vector(n))
    starts = [rollouts(reach, made, seed=seed)["observation"][:, 0] for seed in (1, 1, 2)]
    assert torch.equal(starts[0], starts[1])
    assert not torch.equal(starts[0], starts[2])


def test_the_environments_of_a_single_one_differ(reach, episodes):
    starts = rollouts(reach, episodes(lambda n, seed: Walk()))["observation"][:, 0]
    assert len(starts.unique()) == 4


def test_a_torchrl_environment_without_a_limit_is_given_one(reach, episodes, make_env):
    class Endless(type(make_env(1, 0))):
        horizon = float("inf")

    assert rollouts(reach, episodes(lambda n, seed: Endless(n)))["next", "done"][:, -1].all()


def discrete(env):
    env.action_spec = Categorical(3, shape=env.batch_size)


def wide(env):
    spec = Unbounded((*env.batch_size, 5))
    env.observation_spec = Composite(observation=spec, shape=env.batch_size)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (discrete, r"its actions are 3 choices \(OneHot\); a Gaussian policy gives real"),
        (wide, r"its observations have the shape \[2, 5\]; the demonstrations' are \[2, 1\]"),
    ],
)
def test_specs_that_do_not_fit_are_refused(episodes, make_env, change, message):
    def changed(num_envs, seed):
        env = make_env(num_envs, seed)
        change(env)
        return env

    with pytest.raises(ValueError, match=message):
        episodes(changed)


@pytest.mark.parametrize(
    ("make_env", "message"),
    [
        (lambda n, seed: vector(n, early=True), r"its episodes end at steps \[4.*terminate_when"),
        (lambda n, seed: vector(n, limit=7), r"its episodes end at steps \[7\], and the demo.* 10"),
        (lambda n, seed: vector(n, AutoresetMode.NEXT_STEP), "mode is NEXT_STEP; expected DISABL"),
        (
            lambda n, seed: SyncVectorEnv(
                [lambda: gymnasium.make("Pendulum-v1")] * n, autoreset_mode=AutoresetMode.DISABLED
            ),
            r"time limit is \[200\] steps, and the demonstrations have 10: give .*max_episode_st",
        ),
        (lambda n, seed: vector(3), r"of batch size \[3\]; expected \[2\]"),
        (
            lambda n, seed: vector(n, observed="position"),
            r"the policy reads 'observation', and it gi",
        ),
        (
            lambda n, seed: wrap_gymnasium(vector(n, observed="position"), "place"),
            r"the environment observes \[.*\]; got observation_key=place",
        ),
    ],
)
def test_episodes_that_do_not_fit_are_refused_with_the_cure(episodes, make_env, message):
    with pytest.raises(ValueError, match=message):
        episodes(make_env)


def test_something_that_is_no_environment_is_refused(episodes):
    with pytest.raises(TypeError, match=r"make_env\(2, 0\) returned a list; expected a TorchRL"):
        episodes(lambda n, seed: [])


def test_observations_that_become_infinite_are_refused(episodes, make_env):
    def broken(num_envs, seed):
        env = make_env(num_envs, seed)
        env.step_size = float("inf")
        return env

    with pytest.raises(ValueError, match="its observations become NaN or infinite"):
        episodes(broken)


def test_looking_at_an_episode_draws_no_global_random_numbers(reach, dataset, make_env):
    model, pile = reach.model(), dataset(torch.linspace(-1, 1, 4).unsqueeze(-1))
    torch.manual_seed(3)
    expected = torch.rand(1)
    torch.manual_seed(3)
    Episodes(make_env, model, pile)
    assert torch.equal(torch.rand(1), expected)


def test_a_limit_of_the_users_own_is_left(reach, episodes, make_env):
    batch = rollouts(reach, episodes(lambda n, s: TransformedEnv(make_env(n, s), StepCounter(T))))
    assert batch.shape == (4, T)


def test_a_gymnasium_environment_trains_a_model_from_start_to_end(dataset):
    pile = dataset(torch.linspace(-1, 1, 8).unsqueeze(-1))
    few = {
        "meta_il": {"steps": 10, "steps_per_iteration": 5},
        "training": {"iterations": 2, "rollouts_per_context": 2, "batch": {"trajectories": 8}},
        "contexts_per_batch": 2,
    }
    model = meta_train(lambda n, seed: vector(n, limit=T), pile, **few)
    assert infer(model, pile[0]).context.shape == (3,)
