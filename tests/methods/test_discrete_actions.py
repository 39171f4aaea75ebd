"""Gymnasium environments of discrete actions and dictionaries, from their start to a policy."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from torchrl.envs import GymWrapper, SerialEnv

from pemirl_trl import DemonstrationDataset, InferContext, adapt, infer, meta_train
from pemirl_trl.methods import EpisodeCollector
from pemirl_trl.methods.environments import Episodes

T = 10
KEYS = ["clock", "place.x"]
STEPS = np.array([-0.2, 0.0, 0.2])


class Line(gymnasium.Env):
    """A point on a line goes left, stays or goes right; its observation is nested."""

    def __init__(self, start=0):
        box = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)
        place = gymnasium.spaces.Dict({"x": box, "speed": box})
        self.observation_space = gymnasium.spaces.Dict({"place": place, "clock": box})
        self.action_space = gymnasium.spaces.Discrete(3, start=start)

    def observe(self):
        return {"place": {"x": self.x.copy(), "speed": 0 * self.x}, "clock": np.array([self.time])}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.time = 0.1 * self.np_random.standard_normal(1), 0.0
        return self.observe(), {}

    def step(self, action):
        self.x, self.time = self.x + STEPS[action], self.time + 0.1
        return self.observe(), 0.0, False, False, {}


def vector(num_envs, **options):
    return SyncVectorEnv(
        [lambda: Line(**options)] * num_envs, autoreset_mode=AutoresetMode.DISABLED
    )


def demonstrations(goals, seed=0):
    """Of somebody who walks to each goal, in integers and dictionaries."""
    episodes = []
    for i, goal in enumerate(goals):
        env = Line()
        seen, _ = env.reset(seed=seed + i)
        observed, taken = [seen], []
        for _ in range(T):
            taken.append(int(np.abs(env.x + STEPS - goal).argmin()))
            seen, *_ = env.step(taken[-1])
            observed.append(seen)
        entries = {
            "clock": np.stack([o["clock"] for o in observed]),
            "place": {"x": np.stack([o["place"]["x"] for o in observed])},
        }
        episodes.append((entries, np.array(taken)))
    return DemonstrationDataset.from_episodes(episodes, discrete_actions=3, observation_keys=KEYS)


FEW = {
    "model": {"context_dim": 2},
    "meta_il": {"steps": 20, "steps_per_iteration": 10},
    "training": {"iterations": 3, "rollouts_per_context": 2, "batch": {"trajectories": 8}},
    "contexts_per_batch": 4,
}


@pytest.fixture(scope="module")
def pile():
    return demonstrations(np.linspace(-1, 1, 12))


@pytest.fixture(scope="module")
def model(pile):
    return meta_train(lambda n, seed: vector(n), pile, observation_keys=KEYS, **FEW)


@pytest.mark.parametrize(
    "make_env",
    [
        lambda n, seed: vector(n),
        lambda n, seed: Line(),
        lambda n, seed: SerialEnv(n, lambda: GymWrapper(Line())),
        lambda n, seed: SerialEnv(n, lambda: GymWrapper(Line(), categorical_action_encoding=True)),
    ],
    ids=["vector", "single", "one-hot", "index"],
)
def test_the_action_that_is_stored_is_the_one_that_was_taken(make_env, model, pile):
    episodes = Episodes(make_env, model, pile, observation_keys=KEYS)
    infer = InferContext(model.encoder, pile.trajectories(), rollouts_per_context=2)
    batch = EpisodeCollector(episodes(4, 0, infer), model.policy, T)()
    assert batch.shape == (4, T)
    assert batch["observation"].dtype == torch.float32
    assert (batch["action"].sum(-1) == 1).all()
    moved = (batch["next", "observation"] - batch["observation"])[..., 1]
    expected = batch["action"] @ torch.from_numpy(STEPS).float()
    torch.testing.assert_close(moved, expected, atol=1e-5, rtol=0)
    clock = 0.1 * torch.arange(T).expand(4, T)
    torch.testing.assert_close(batch["observation"][..., 0], clock, atol=1e-5, rtol=0)


def test_one_demonstration_gives_a_reward_and_a_policy(model, pile):
    assert model.config.actions == "discrete"
    assert infer(model, pile[0]).reward(pile.observation[0]).shape == (T + 1, 1)
    result = adapt(
        model,
        pile[3],
        lambda n, seed: vector(n),
        observation_keys=KEYS,
        rollouts=4,
        optimization={"iterations": 2},
    )
    assert result.learned_return >= result.carried_over_return
    assert result.policy.action_dim == 3


def test_vectors_of_real_numbers_are_no_demonstration_of_choices(model, pile):
    blurred = DemonstrationDataset(pile.observation[:1], pile.action[:1] + 0.1)
    with pytest.raises(ValueError, match="this model was trained on 3 choices, one-hot"):
        infer(model, blurred)


@pytest.mark.parametrize(
    ("make_env", "keys", "message"),
    [
        (lambda n, seed: vector(n, start=1), KEYS, r"counts from 0: wrap it, .*action \+ 1"),
        (lambda n, seed: vector(n), None, r"observation_keys=\[...\] makes the observation"),
        (lambda n, seed: vector(n), ["x"], r"ones of \['clock', 'place.speed', 'place.x'\]"),
        (lambda n, seed: vector(n), ["clock"], r"have the shape \[2, 1\]; the demonstrations' are"),
    ],
)
def test_what_does_not_fit_is_said_with_its_cure(make_env, keys, message, model, pile):
    with pytest.raises(ValueError, match=message):
        Episodes(make_env, model, pile, observation_keys=keys)


def test_choices_do_not_fit_an_environment_of_real_numbers(model, pile, make_env):
    with pytest.raises(ValueError, match=r"a categorical policy takes .*model.actions=continuous"):
        Episodes(make_env, model, pile)


def test_several_choices_at_once_are_refused(model, pile):
    class Both(Line):
        def __init__(self):
            super().__init__()
            self.action_space = gymnasium.spaces.MultiDiscrete([3, 2])

        def step(self, action):
            return super().step(action[0])

    with pytest.raises(ValueError, match="count their combinations"):
        Episodes(
            lambda n, seed: SerialEnv(n, lambda: GymWrapper(Both())),
            model,
            pile,
            observation_keys=KEYS,
        )
