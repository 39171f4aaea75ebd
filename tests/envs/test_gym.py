import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

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
    assert np.abs(np.stack(info["final_obs"]) - last).max() < 0.06  # one step at 1 m/s
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


def test_unknown_reset_options_are_refused_by_name():
    single, batch = gymnasium.make(LEFT).unwrapped, make_vec()
    with pytest.raises(ValueError, match=r"option\(s\) \['goal'\]; expected one of \['task'\]"):
        single.reset(options={"goal": (0.3, 0.5)})
    with pytest.raises(ValueError, match=r"\['mask', 'target'\]; expected one of \['task', 'reset"):
        batch.reset(options={"target": 1, "mask": 2, "task": {"goal": (0.3, 0.5)}})
    for env in (single, batch):
        with pytest.raises(
            ValueError, match=r"'task' is \(0.3, 0.5\); expected parameters by name"
        ):
            env.reset(options={"task": (0.3, 0.5)})


@pytest.mark.parametrize(
    ("mask", "kind"),
    [
        ([True, False, False], TypeError),
        (np.array([1, 0, 0]), TypeError),
        (np.array([True, False]), ValueError),
        (np.zeros(3, dtype=bool), ValueError),
    ],
)
def test_masks_that_gymnasium_refuses_are_refused(mask, kind):
    for vectorization_mode in (None, "sync"):
        env = make_vec(vectorization_mode=vectorization_mode)
        env.reset(seed=0)
        with pytest.raises(kind, match="reset_mask"):
            env.reset(options={"reset_mask": mask})


def test_an_unknown_mode_or_length_is_refused():
    message = r"unknown autoreset_mode 'Never'; expected one of \['NextStep', 'SameStep', 'Disab"
    with pytest.raises(ValueError, match=message):
        make_vec(autoreset_mode="Never")
    for steps in (0, -2, 1.5, True):
        with pytest.raises(ValueError, match=r"max_episode_steps is .*; expected a positive integ"):
            make_vec(max_episode_steps=steps)


@pytest.mark.parametrize(("given", "length"), [(20, 20), (1000, 100), (-1, 100), (None, 100)])
def test_episodes_may_be_cut_short(given, length):
    env = make_vec(2, max_episode_steps=given)
    env.reset(seed=0)
    ends = [env.step(np.ones((2, 2), np.float32))[3].all() for _ in range(2 * length)]
    assert np.flatnonzero(ends).tolist() == [length - 1, 2 * length - 1]


def sync_vector_env(mode, max_episode_steps):
    return gymnasium.make_vec(
        LEFT,
        3,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        max_episode_steps=max_episode_steps,
    )


def assert_equal_shape(one, other):
    """The same keys, masks, types and shapes; zeros and None where a mask is False."""
    assert one.keys() == other.keys()
    for key, value in one.items():
        if isinstance(value, dict):
            assert_equal_shape(value, other[key])
        elif key.startswith("_"):
            np.testing.assert_array_equal(value, other[key])
        elif value.dtype == object:
            assert [part is None for part in value] == [part is None for part in other[key]]
        else:
            assert (value.dtype, value.shape) == (other[key].dtype, other[key].shape)
            missing = ~one[f"_{key}"]
            np.testing.assert_array_equal(value[missing], other[key][missing])


@pytest.mark.parametrize("mode", [*AutoresetMode])
@pytest.mark.parametrize("max_episode_steps", [None, 7])
def test_autoreset_is_gymnasiums_own(mode, max_episode_steps):
    """Beside SyncVectorEnv: the same flags, rewards of ignored steps, and kinds of infos."""
    given = {"task": {"goal": (0.2, 0.5)}}  # each draws from streams of its own
    ours = make_vec(autoreset_mode=mode.value, max_episode_steps=max_episode_steps)
    theirs = sync_vector_env(mode, max_episode_steps)
    assert ours.metadata["autoreset_mode"] is mode
    for env in (ours, theirs):
        env.reset(seed=0, options=dict(given))
    mask = np.array([False, True, False])
    for step in range(3 * (max_episode_steps or 100)):
        results = [env.step(np.ones((3, 2), np.float32)) for env in (ours, theirs)]
        (_, reward, *flags, info), (_, their_reward, *their_flags, their_info) = results
        np.testing.assert_array_equal(flags, their_flags)
        np.testing.assert_array_equal(reward == 0, their_reward == 0)
        assert_equal_shape(info, their_info)
        over = flags[1]
        if step == 3:  # from here on, episodes end at different times
            over = mask
        if over.any() and (step == 3 or mode is AutoresetMode.DISABLED):
            options = given | {"reset_mask": over.copy()}
            for env in (ours, theirs):
                env.reset(options=dict(options))


def test_the_mode_does_not_change_what_happens():
    """The same episodes of all: only where their first observations appear differs."""
    seen = {}
    for mode in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
        env = gymnasium.make_vec(
            "pemirl_envs/PointMazeStochastic-v0", 2, autoreset_mode=mode, max_episode_steps=5
        )
        steps = [env.reset(seed=0)[0]]
        for _ in range(14):
            observation, _, _, _, info = env.step(np.ones((2, 2), np.float32))
            if "final_obs" in info:
                steps.append(np.stack(info["final_obs"]))
            steps.append(observation)
        seen[mode] = np.stack(steps)[:15]
    np.testing.assert_array_equal(*seen.values())


def test_a_step_after_the_end_is_refused_where_nobody_resets():
    env = make_vec(autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=2)
    env.reset(seed=0)
    env.reset(options={"reset_mask": np.array([True, False, True])})
    for _ in range(2):
        last = env.step(np.ones((3, 2), np.float32))
    assert last[3].all()
    with pytest.raises(
        RuntimeError, match=r"episode\(s\) \[0, 1, 2\] are over; in the mode Disabl"
    ):
        env.step(np.ones((3, 2), np.float32))
    env.reset(options={"reset_mask": np.array([True, False, False])})
    with pytest.raises(RuntimeError, match=r"episode\(s\) \[1, 2\] are over"):
        env.step(np.ones((3, 2), np.float32))


def test_the_action_of_an_ignored_step_is_ignored():
    env = make_vec(autoreset_mode=AutoresetMode.NEXT_STEP, max_episode_steps=3)
    env.reset(seed=0)
    actions = np.ones((3, 2), np.float32)
    env.step(actions)
    env.reset(options={"reset_mask": np.array([False, True, False])})
    for _ in range(2):
        *_, ended, _ = env.step(actions)
    assert ended.tolist() == [True, False, True]
    with pytest.raises(ValueError, match=r"expected an action of shape \(3, 2\), got \(2, 2\)"):
        env.step(actions[:2])
    actions[0] = np.nan
    observation, reward, *_ = env.step(actions)
    assert np.abs(observation[[0, 2]] - (0.3, 0.0)).max() <= 0.05
    assert (reward == 0).tolist() == [True, False, True]
    with pytest.raises(pemirl_envs.SimulationError, match="0: the action is not finite"):
        env.step(actions)
