import gymnasium
import numpy as np
import pytest

import pemirl_envs
from pemirl_envs.gym import gym_id

LEFT = "pemirl_envs/PointMazeLeft-v0"


def make_vec(num_envs=3, **kwargs):
    return gymnasium.make_vec(LEFT, num_envs, **kwargs)


def test_ids():
    assert gym_id("point_maze/left") == LEFT
    assert gym_id("point_maze/stochastic_left") == "pemirl_envs/PointMazeStochasticLeft-v0"
    assert {gym_id(name) for name in pemirl_envs.TASKS} <= gymnasium.registry.keys()


def test_a_task_may_be_given():
    env = gymnasium.make(LEFT)
    position, info = env.reset(seed=0, options={"task": {"goal": (0.2, 0.5)}})
    np.testing.assert_allclose(info["task"]["goal"], (0.2, 0.5))
    _, reward, _, _, info = env.step(np.zeros(2, np.float32))
    assert reward == pytest.approx(-np.linalg.norm(position - (0.2, 0.5)), abs=1e-6)
    np.testing.assert_allclose(info["task"]["goal"], (0.2, 0.5))


def test_a_batch_takes_one_task_for_all_or_one_for_each():
    env = make_vec()
    _, info = env.reset(options={"task": {"goal": (0.2, 0.5)}})
    np.testing.assert_allclose(info["task"]["goal"], [(0.2, 0.5)] * 3)
    each = [(0.1, 0.5), (0.2, 0.5), (0.3, 0.5)]
    _, info = env.reset(options={"task": {"goal": each}})
    np.testing.assert_allclose(info["task"]["goal"], each)


def test_a_batch_resets_the_masked_alone():
    env = make_vec()
    env.reset(seed=0)
    before, *_, old = env.step(np.ones((3, 2), np.float32))
    mask = np.array([False, True, False])
    after, new = env.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(after[~mask], before[~mask])
    np.testing.assert_array_equal(new["task"]["goal"][~mask], old["task"]["goal"][~mask])
    assert not np.array_equal(after[mask], before[mask])


def test_a_batch_begins_anew_in_the_step_that_ends_an_episode():
    env = make_vec()
    observation, _ = env.reset(seed=0)
    for _ in range(100):
        last = observation
        observation, _, terminated, truncated, info = env.step(np.ones((3, 2), np.float32))
    assert truncated.all()
    assert not terminated.any()
    assert np.abs(info["final_obs"] - last).max() < 0.06  # one step at 1 m/s
    assert np.abs(observation - (0.3, 0.0)).max() <= 0.05
    assert not np.array_equal(info["final_info"]["task"]["goal"], info["task"]["goal"])
    assert not env.step(np.ones((3, 2), np.float32))[3].any()


def test_failures_carry_what_the_others_did():
    env = make_vec()
    before, _ = env.reset(seed=0)
    actions = np.ones((3, 2), np.float32)
    actions[1] = np.nan
    with pytest.raises(pemirl_envs.SimulationError, match="1: the action is not finite") as caught:
        env.step(actions)
    observation, reward, *_ = caught.value.partial
    assert np.isfinite(reward).tolist() == [True, False, True]
    np.testing.assert_array_equal(observation[1], before[1])
    single = gymnasium.make(LEFT).unwrapped
    single.reset()
    with pytest.raises(pemirl_envs.SimulationError, match="0: the action is not finite"):
        single.step(actions[1])


def test_bad_input_is_refused():
    env = gymnasium.make(LEFT).unwrapped
    env.reset()
    with pytest.raises(ValueError, match=r"expected an action of shape \(1, 2\), got \(1, 3\)"):
        env.step(np.zeros(3, np.float32))
    with pytest.raises(ValueError, match=r"goal of simulation\(s\) \[0\] is"):
        env.reset(options={"task": {"goal": (2.0, 0.5)}})
    with pytest.raises(ValueError, match=r"expected goal of shape \[3, 2\], got \[2, 2\]"):
        make_vec().reset(options={"task": {"goal": [(0.1, 0.5), (0.2, 0.5)]}})
    with pytest.raises(ValueError, match="unknown render mode 'human'"):
        pemirl_envs.gym.GymEnv("point_maze/left", render_mode="human")
