import dm_env
import numpy as np
import pytest
import torch
from dm_control.rl.control import PhysicsError
from torchrl.envs import DMControlWrapper

import pemirl_envs


def load(task="left", **task_kwargs):
    return pemirl_envs.load("point_maze", task, task_kwargs={"random": 0} | task_kwargs)


def test_an_episode_ends_at_the_horizon_without_termination():
    env = load()
    step, count = env.reset(), 0
    while not step.last():
        step = env.step(np.ones(2))
        count += 1
    assert count == 100
    assert (step.step_type, step.discount) == (dm_env.StepType.LAST, 1.0)
    assert env.control_timestep() == pytest.approx(0.05)


def test_the_seed_may_be_a_random_state():
    first = load().reset().observation["observation"]
    again = load(random=np.random.RandomState(0)).reset().observation["observation"]
    other = load(random=1).reset().observation["observation"]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_given_task_holds_in_every_episode():
    env = load(parameters={"goal": (0.2, 0.5)})
    for _ in range(2):
        env.reset()
        assert env.task.parameters["goal"].tolist() == [pytest.approx([0.2, 0.5])]
    position = env.reset().observation["observation"]
    reward = env.step(np.zeros(2)).reward
    assert reward == pytest.approx(-np.linalg.norm(position - np.array([0.2, 0.5])), abs=1e-6)


def test_environment_options_of_dm_control():
    env = pemirl_envs.load(
        "point_maze",
        "right",
        task_kwargs={"time_limit": 1.0, "split": "test"},
        environment_kwargs={"flat_observation": True},
        visualize_reward=True,
    )
    step = env.reset()
    assert step.observation["observations"].shape == (2,)
    for _ in range(20):
        step = env.step(np.zeros(2))
    assert step.last()


@pytest.mark.parametrize("legacy_step", [True, False])
def test_both_stepping_orders_of_dm_control_agree_with_the_batch(legacy_step):
    env = pemirl_envs.load(
        "point_maze",
        "stochastic",
        task_kwargs={"random": 0},
        environment_kwargs={"legacy_step": legacy_step},
    )
    batch = pemirl_envs.make("point_maze/stochastic", 1, seed=0)
    env.reset(), batch.reset()
    for action in np.random.default_rng(0).uniform(-1, 1, (50, 2)).astype(np.float32):
        env.step(action)
        batch.episodes.step(torch.from_numpy(action)[None])
    qpos = batch.episodes.simulation.field("qpos")[0].numpy()
    np.testing.assert_array_equal(env.physics.data.qpos, qpos)


def test_torchrls_wrapper_seeds_and_truncates_it():
    env = DMControlWrapper(load())
    runs = []
    for seed in (3, 3, 4):
        env.set_seed(seed)
        runs.append(env.reset()["observation"])
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])
    data = env.rollout(200)["next"]
    assert data.shape == (100,)
    assert data["truncated"][-1]
    assert not data["terminated"].any()


def test_bad_input_is_refused():
    env = load()
    env.reset()
    with pytest.raises(ValueError, match=r"expected an action of shape \(2,\), got \(3,\)"):
        env.step(np.zeros(3))
    with pytest.raises(pemirl_envs.SimulationError, match="0: the action is not finite"):
        env.step(np.array([np.nan, 0.0]))
    env.physics.data.qvel[:] = 1e12
    with pytest.raises(PhysicsError, match="BADQ"):
        env.step(np.zeros(2))
    with pytest.raises(ValueError, match="unknown task 'cartpole/swingup'; expected one of"):
        pemirl_envs.load("cartpole", "swingup")
    with pytest.raises(ValueError, match="unknown split 'dev'; expected one of"):
        load(split="dev")
    with pytest.raises(ValueError, match=r"goal of simulation\(s\) \[0\] is .* legal values"):
        load(parameters={"goal": (0.3, 0.7)})
    with pytest.raises(ValueError, match=r"expected the task parameters \['goal'\], got \['aim'\]"):
        load(parameters={"aim": 1.0})
