import math

import mujoco
import numpy as np
import pytest
import scipy.stats
import torch
from mujoco.batch import Batch

import pemirl_envs
from pemirl_envs.simulation import MujocoBatch
from pemirl_envs.tasks.sweeper import Sweeper

# Behind the ball, which lies at (0, 0): the arm's first two joints, the others straight.
BEHIND = (math.pi / 2 + 0.05, 0.32)


def begin(model, num_sims, ball=(0.0, 0.35)):
    """Simulations whose blade is on the table, behind the ball."""
    batch = MujocoBatch(model, num_sims, 1, Sweeper.stage)
    qpos = torch.zeros(num_sims, 9)
    qpos[:, :2] = torch.tensor(BEHIND)
    qpos[:, 7:] = torch.tensor(ball)
    batch.write({"qpos": qpos})
    return batch


def play(model, controls):
    """States [T, N, 18] under controls [T, N, 7]."""
    batch, states = begin(model, controls.shape[1]), []
    for control in controls:
        batch.write({"ctrl": control})
        batch.step(Sweeper.n_sub_steps)
        states.append(torch.cat([batch.field("qpos"), batch.field("qvel")], -1))
    return torch.stack(states)


@pytest.mark.parametrize("variant", ["normal", "shift"])
def test_moves_as_the_model_without_pairs_and_flags_to_the_last_bit(variant):
    task = pemirl_envs.get_task(f"sweeper/{variant}")
    plain = task.build_spec()
    plain.option.disableflags = mujoco.mjtDisableBit.mjDSBL_ISLAND
    for pair in list(plain.pairs):
        plain.delete(pair)
    for geom in plain.geoms:
        geom.condim, geom.margin = 1, 0.001
        geom.contype = geom.name in ("blade", "lip_left", "lip_right")
        geom.conaffinity = geom.name in ("object", "table")
    generator = torch.Generator().manual_seed(0)
    push = torch.tensor([0.0, 0.5, 0, -0.25, 0, 0, 0])
    controls = (push + 0.5 * torch.randn(60, 20, 7, generator=generator)).clamp(-1, 1)
    got, expected = play(task.model, controls), play(plain.compile(), controls)
    assert torch.equal(got, expected)
    assert (got[-1, :, 7:9] != got[0, :, 7:9]).any(1).float().mean() > 0.5  # contacts took part


def rotation(axis, angle):
    c, s = math.cos(angle), math.sin(angle)
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def blade_position(q):
    """Forward kinematics by hand: links along x of 0.1, 0.4, 0.321 and 0.1 m."""
    position, frame = np.array([0.0, -0.6, 0.0]), np.eye(3)
    links = (0.1, 0, 0.4, 0, 0.321, 0, 0.1)
    for axis, angle, length in zip("zyxyxyx", q, links, strict=True):
        frame = frame @ rotation(axis, angle)
        position = position + frame @ [length, 0, 0]
    return position


def test_the_observation_is_that_of_the_current_state():
    env = pemirl_envs.make("sweeper/normal", 2, seed=0)
    data = env.reset()
    for _ in range(20):
        data = env.rand_step(data)["next"].exclude("reward")
    qpos, qvel = env.episodes.simulation.field("qpos"), env.episodes.simulation.field("qvel")
    for i in range(2):
        ball = (*qpos[i, 7:].tolist(), -0.275)
        expected = [*qpos[i, :7], *qvel[i, :7], *blade_position(qpos[i, :7].tolist()), *ball]
        np.testing.assert_allclose(data["observation"][i], expected, atol=1e-6)


def test_reward_by_hand():
    env = pemirl_envs.make("sweeper/normal", 2, seed=0)
    goal = torch.tensor([[0.3, 0.1], [-0.2, 0.25]])
    data = env.reset(env.reset().update({"task": {"goal": goal}}))
    step = env.rand_step(data.clone())
    for i in range(2):
        ball = data["observation"][i, 17:].tolist()
        to_ball = math.dist((0.921, -0.6, 0.0), ball)  # the arm is stretched out along x
        expected = -to_ball - math.dist(ball[:2], goal[i].tolist())
        assert step["next", "reward"][i].item() == pytest.approx(expected, abs=1e-6)


def test_episodes_begin_with_the_arm_aside_and_the_ball_in_its_rectangle():
    env = pemirl_envs.make("sweeper/normal", 4000, seed=0)
    data = env.reset()
    assert (env.episodes.simulation.field("qpos")[:, :7] == 0).all()
    velocity = env.episodes.simulation.field("qvel")[:, :7]
    ball = data["observation"][:, 17:19].double()
    drawn = [(ball[:, 0], -0.1, 0.2), (ball[:, 1], -0.1, 0.1), (velocity[:, 3], -0.005, 0.01)]
    for values, low, width in drawn:
        law = scipy.stats.uniform(low, width)
        assert scipy.stats.kstest(values.numpy(), law.cdf).pvalue > 0.01
    correlation = np.corrcoef(ball.T, data["task", "goal"].T)[:2, 2:]
    assert np.abs(correlation).max() < 0.06  # the ball does not tell the goal


def test_the_blade_pushes_the_ball_and_does_not_pass_through_it():
    batch = begin(pemirl_envs.get_task("sweeper/normal").model, 1)
    batch.write({"ctrl": torch.tensor([[0, 0.25, 0, -0.5, 0, 0, 0]])})  # stretches the elbow
    batch.step(40)
    start, gaps = batch.field("qpos")[0, 8].item(), []
    for _ in range(40):
        batch.step(1)
        gaps.append((batch.field("qpos")[0, 8] - batch.field("site_xpos")[0, 0, 1]).item())
    assert batch.field("qpos")[0, 8].item() > start
    assert min(gaps) > 0.0


def test_the_blade_rests_on_the_table():
    batch = begin(pemirl_envs.get_task("sweeper/normal").model, 1, ball=(1.0, 1.0))
    batch.write({"ctrl": torch.tensor([[0, 1.0, 0, 1.0, 0, 1.0, 0]])})
    for _ in range(20):
        batch.step(10)
        assert batch.field("site_xpos")[0, 0, 2].item() > -0.325 + 0.015  # radius 2 cm, soft


def test_joints_stay_within_their_ranges():
    task = pemirl_envs.get_task("sweeper/normal")
    generator = torch.Generator().manual_seed(0)
    batch = MujocoBatch(task.model, 16, 1)
    low, high = torch.from_numpy(task.model.jnt_range[:7]).T
    for _ in range(20):
        batch.write({"ctrl": torch.randn(16, 7, generator=generator).sign()})
        batch.step(50)
        angle = batch.field("qpos")[:, :7]
        assert ((angle > low - 0.1) & (angle < high + 0.1)).all()


def test_the_shift_has_a_narrow_blade_and_more_damping():
    normal, shift = (pemirl_envs.get_task(f"sweeper/{v}").model for v in ("normal", "shift"))
    np.testing.assert_allclose(shift.dof_damping[:7], 3 * normal.dof_damping[:7])
    assert (shift.dof_damping[7:] == normal.dof_damping[7:]).all()
    assert (normal.geom("blade").size[1], shift.geom("blade").size[1]) == (0.15, 0.08)
    assert shift.geom("lip_left").pos[1] == pytest.approx(0.08)
    assert shift.geom("lip_right").pos[1] == pytest.approx(-0.08)


def sweep(task, steps=100, samples=32, plan_steps=15):
    """A sampling model predictive controller (MPPI): the ball's final distance to its goal."""
    rng, generator = np.random.default_rng(1), torch.Generator().manual_seed(1)
    goal = task.sample_parameters(1, "test", generator)
    real, model = Batch(task.model, 1, 1), Batch(task.model, samples, 1)
    real.qpos[:] = task.initial_state(goal, generator)["qpos"].numpy()
    fields = {name: model.bind(name) for name in ("qpos", "site_xpos")}
    plan = np.zeros((plan_steps, 7))
    for _ in range(steps):
        noise = rng.normal(size=(samples, plan_steps, 7))
        for h in range(1, plan_steps):
            noise[:, h] = 0.8 * noise[:, h - 1] + 0.6 * noise[:, h]
        controls = (plan + 0.5 * noise).clip(-1, 1)
        model.state[:] = real.state
        total = 0.0
        for h in range(plan_steps):
            model.ctrl[:] = controls[:, h]
            model.step(nstep=task.n_sub_steps, stage=task.stage)
            read = {name: torch.tensor(values) for name, values in fields.items()}
            last = task.reward(read.__getitem__, torch.from_numpy(controls[:, h]), goal).double()
            total += last
        weights = torch.softmax((total + 3 * last) / (0.02 * plan_steps), 0).numpy()
        plan = np.einsum("n,nha->ha", weights, controls)
        real.ctrl[:] = plan[0]
        real.step(nstep=task.n_sub_steps)
        plan = np.concatenate([plan[1:], plan[-1:]])
    return math.dist(real.qpos[0, 7:], goal["goal"][0])


@pytest.mark.long
@pytest.mark.parametrize("variant", ["normal", "shift"])
def test_a_sampling_controller_sweeps_the_ball_to_its_goal(variant):
    assert sweep(pemirl_envs.get_task(f"sweeper/{variant}")) < 0.1  # from 0.22 m
