"""Laws of every registered task and variant, on its three faces."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs.utils import check_env_specs

import pemirl_envs
from pemirl_envs.gym import gym_id

SEED = 7
EPISODES = 2

every_task = pytest.mark.parametrize("name", pemirl_envs.TASKS)

LONGEST_EPISODE = 100  # steps; a law that holds over two episodes of these holds over longer ones
TASK_TYPES = {type(build()) for build in pemirl_envs.TASKS.values()}


@pytest.fixture(autouse=True)
def short_episodes(monkeypatch):
    for task in TASK_TYPES:
        monkeypatch.setattr(task, "horizon", min(task.horizon, LONGEST_EPISODE))


def random_actions(name: str, *, num_envs: int = 1, beyond: float = 1.5) -> torch.Tensor:
    """Actions [T, N, A] for two episodes, some of them outside the bounds."""
    task = pemirl_envs.get_task(name)
    low, high = task.action_bounds
    shape = (EPISODES * task.horizon, num_envs, len(low))
    unit = torch.rand(shape, generator=torch.Generator().manual_seed(0))
    return beyond * (low + (high - low) * unit)


def play_torchrl(name: str, actions: torch.Tensor, **kwargs):
    env = pemirl_envs.make(name, actions.shape[1], seed=SEED, **kwargs)
    data = env.reset()
    first, steps = data["observation"], []
    for action in actions:
        step, data = env.step_and_maybe_reset(data.set("action", action))
        steps.append(step)
    data = torch.stack(steps)["next"]
    return first, data["observation"], data["reward"][..., 0]


def play_dm_control(name: str, actions: torch.Tensor):
    env = pemirl_envs.load(*name.split("/"), task_kwargs={"random": SEED})
    first, observations, rewards = env.reset().observation["observation"], [], []
    for action in actions[:, 0].numpy():
        step = env.step(action)
        observations.append(step.observation["observation"])
        rewards.append(step.reward)
        if step.last():
            env.reset()
    return stacked(first, observations, rewards)


def play_gym(name: str, actions: torch.Tensor):
    env = gymnasium.make(gym_id(name)).unwrapped
    (first, _), observations, rewards = env.reset(seed=SEED), [], []
    for action in actions[:, 0].numpy():
        observation, reward, _, truncated, _ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        if truncated:
            env.reset()
    return stacked(first, observations, rewards)


def stacked(first, observations, rewards):
    """The same shapes as the batched faces: [1, D], [T, 1, D], [T, 1]."""
    observations = torch.from_numpy(np.stack(observations))[:, None]
    rewards = torch.tensor(rewards, dtype=torch.float32)[:, None]
    return torch.from_numpy(first)[None], observations, rewards


def play_gym_vector(name: str, actions: torch.Tensor):
    env = gymnasium.make_vec(gym_id(name), actions.shape[1])
    (first, _), observations, rewards = env.reset(seed=SEED), [], []
    for action in actions.numpy():
        observation, reward, _, truncated, info = env.step(action)
        observations.append(np.stack(info["final_obs"]) if truncated.any() else observation)
        rewards.append(reward)
    rewards = torch.from_numpy(np.stack(rewards))
    return torch.from_numpy(first), torch.from_numpy(np.stack(observations)), rewards


def assert_same(expected, got):
    for a, b in zip(expected, got, strict=True):
        torch.testing.assert_close(b, a, rtol=0, atol=0)


@every_task
@pytest.mark.parametrize("play", [play_dm_control, play_gym, play_gym_vector])
def test_faces_agree_to_the_last_bit(name, play):
    actions = random_actions(name)
    assert_same(play_torchrl(name, actions), play(name, actions))


@every_task
def test_batched_faces_agree_to_the_last_bit(name):
    actions = random_actions(name, num_envs=5)
    assert_same(play_torchrl(name, actions), play_gym_vector(name, actions))


@every_task
@pytest.mark.parametrize("play", [play_torchrl, play_dm_control, play_gym, play_gym_vector])
def test_results_do_not_depend_on_the_default_dtype(name, play):
    actions = random_actions(name)[: LONGEST_EPISODE + 5]
    expected = play(name, actions)
    torch.set_default_dtype(torch.float64)
    assert_same(expected, play(name, actions))


@every_task
def test_what_a_task_gives_does_not_depend_on_the_default_dtype(name):
    def facts():
        task = pemirl_envs.get_task(name)
        sets = [task.task_set(split) for split in task.splits if split in ("train_100", "test")]
        drawn = task.sample_parameters(9, task.splits[-1], torch.Generator().manual_seed(0))
        tensors = [value for values in (*sets, drawn) for value in values.values()]
        bounds = [bound for pair in task.parameter_bounds.values() for bound in pair]
        return [*tensors, *bounds, *task.action_bounds]

    def specs():
        env = pemirl_envs.make(name, 2, seed=SEED)
        return env.specs

    expected, expected_specs = facts(), specs()
    torch.set_default_dtype(torch.float64)
    assert_same(expected, facts())
    assert specs() == expected_specs


@every_task
def test_results_do_not_depend_on_the_number_of_threads(name):
    actions = random_actions(name, num_envs=7)
    assert_same(
        play_torchrl(name, actions, num_threads=1), play_torchrl(name, actions, num_threads=3)
    )


@every_task
def test_clipping_is_the_environments(name):
    low, high = pemirl_envs.get_task(name).action_bounds
    actions = random_actions(name, beyond=3.0)
    clipped = actions.clamp(low, high)
    assert not torch.equal(actions, clipped)
    assert_same(play_torchrl(name, actions), play_torchrl(name, clipped))


@every_task
@pytest.mark.filterwarnings("ignore:.*observation space (minimum|maximum) value is:UserWarning")
def test_specs_hold(name):
    check_env_specs(pemirl_envs.make(name, 3, seed=SEED))
    check_env(gymnasium.make(gym_id(name)).unwrapped, skip_render_check=True)
    env = pemirl_envs.load(*name.split("/"))
    step = env.reset()
    for key, spec in env.observation_spec().items():
        spec.validate(step.observation[key])
    step = env.step(env.action_spec().maximum)
    env.reward_spec().validate(np.asarray(step.reward))


@every_task
def test_resets_follow_the_seed(name):
    def first_episodes(seed):
        env = pemirl_envs.make(name, 4, seed=seed)
        return torch.stack([env.reset(), env.reset()])

    data = first_episodes(1)
    assert (data == first_episodes(1)).all()
    other = first_episodes(2)
    assert not torch.equal(data["observation"], other["observation"])
    assert not torch.equal(data["observation"][0], data["observation"][1])
    assert not torch.equal(flat_parameters(data[0]), flat_parameters(data[1]))


@every_task
def test_reseeding_equals_a_new_environment(name):
    env = pemirl_envs.make(name, 4, seed=1)
    env.rollout(3)
    env.set_seed(SEED)
    assert (env.reset() == pemirl_envs.make(name, 4, seed=SEED).reset()).all()


@every_task
def test_the_observation_holds_nothing_of_the_task(name):
    task = pemirl_envs.get_task(name)
    low_box = {key: low for key, (low, _) in task.parameter_bounds.items()}
    high_box = {key: high for key, (_, high) in task.parameter_bounds.items()}
    runs = []
    for parameters in (low_box, high_box):
        env = pemirl_envs.make(name, 2, seed=SEED)
        data = env.reset(env.reset().update({"task": parameters_for(parameters, 2)}))
        actions = random_actions(name, num_envs=2)[: task.horizon]
        steps = []
        for action in actions:
            step = env.step(data.set("action", action))
            steps.append(step["next"].clone())
            data = step["next"].exclude("reward")
        runs.append(torch.stack(steps))
    assert torch.equal(runs[0]["observation"], runs[1]["observation"])
    assert not torch.equal(runs[0]["reward"], runs[1]["reward"])


@every_task
def test_episodes_have_the_horizons_length(name):
    env = pemirl_envs.make(name, 2, seed=SEED)
    horizon = env.task.horizon
    data = env.rollout(2 * horizon, break_when_any_done=False)["next"]
    expected = torch.arange(1, 2 * horizon + 1) % horizon == 0
    assert torch.equal(data["truncated"][..., 0], expected.expand(2, -1))
    assert torch.equal(data["done"], data["truncated"])
    assert not data["terminated"].any()


@every_task
def test_a_task_names_its_own_quantities(name):
    task = pemirl_envs.get_task(name)
    names = [part.name for part in task.observation_components]
    assert len(set(names)) == len(names)
    assert all(part.size >= 1 and part.unit for part in task.observation_components)
    assert task.components(names) == list(range(task.observation_size))
    assert task.task_space_indices() == task.components(task.task_space) != []
    assert task.task_key in task.parameter_bounds


@every_task
def test_outcomes_are_one_number_for_each_episode(name):
    task = pemirl_envs.get_task(name)
    data = pemirl_envs.make(name, 5, seed=SEED).rollout(9, break_when_any_done=False)
    parameters = dict(data["task"][:, 0].items())
    for outcome in task.outcomes.values():
        value = outcome(data["observation"], parameters)
        assert value.shape == (5,)
        assert len(value.unique()) == 5


@every_task
def test_the_reward_of_what_is_observed_is_the_true_one(name):
    env = pemirl_envs.make(name, 5, seed=SEED)
    data = env.rollout(40, break_when_any_done=False)
    beyond = data["action"] * 3  # clipped, as the environment does
    for action in (data["action"], beyond.clamp(*env.task.action_bounds)):
        got = env.task.state_reward(data["observation"], action, dict(data["task"].items()))
        assert got.shape == (5, 40)
        assert got.dtype == torch.float32
    clipped = env.task.state_reward(data["observation"], beyond, dict(data["task"].items()))
    assert torch.equal(clipped, got)
    got = env.task.state_reward(data["observation"], data["action"], dict(data["task"].items()))
    torch.testing.assert_close(got, data["next", "reward"][..., 0], rtol=0, atol=1e-6)
    assert got.unique().numel() > 100


@every_task
def test_a_planar_task_and_no_other_has_a_layout(name):
    task = pemirl_envs.get_task(name)
    if task.planar:
        assert task.layout().walls
        assert task.observation_size == 2
    else:
        with pytest.raises(ValueError, match="is not a planar task, so it has no layout"):
            task.layout()


@every_task
def test_a_scripted_controller_acts_within_the_bounds(name):
    env = pemirl_envs.make(name, 5, seed=SEED)
    controller = env.task.scripted_controller()
    if controller is None:
        return
    data = env.reset()
    action = controller(data["observation"], dict(data["task"].items()))
    low, high = env.task.action_bounds
    assert action.shape == (5, len(low))
    assert ((action >= low) & (action <= high)).all()


@every_task
def test_every_split_gives_legal_tasks(name):
    task = pemirl_envs.get_task(name)
    for split in task.splits:
        parameters = task.sample_parameters(50, split, torch.Generator().manual_seed(0))
        task.validate_parameters(parameters, 50)  # raises for an illegal one
        assert parameters.keys() == task.parameter_bounds.keys()
        assert {len(value) for value in parameters.values()} == {50}


def parameters_for(values, num_envs):
    return {key: value.expand(num_envs, *value.shape) for key, value in values.items()}


def flat_parameters(data):
    return torch.cat([value.flatten() for value in data["task"].values()])
