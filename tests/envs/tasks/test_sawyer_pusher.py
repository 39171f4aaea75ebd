import math

import mujoco
import numpy as np
import pytest
import scipy.stats
import torch

import pemirl_envs
from pemirl_envs.simulation import MujocoBatch
from pemirl_envs.tasks.sawyer_pusher import SawyerPusher


def play(model, targets):
    """States [T, N, 27] while the hand's target follows [T, N, 3]."""
    num_sims = targets.shape[1]
    task = pemirl_envs.get_task("sawyer_pusher/normal")
    goal = {"goal": torch.tensor([[0.0, 0.9]]).expand(num_sims, 2)}
    batch, states = MujocoBatch(model, num_sims, 1), []
    batch.write(task.initial_state(goal, torch.Generator().manual_seed(0)))
    for target in targets:
        mocap = batch.field("mocap_pos").clone()
        mocap[:, 0] = target
        batch.write({"mocap_pos": mocap})
        batch.step(SawyerPusher.n_sub_steps)
        states.append(torch.cat([batch.field("qpos"), batch.field("qvel")], -1))
    return torch.stack(states)


@pytest.mark.parametrize("variant", ["normal", "shift"])
def test_moves_as_the_model_without_pairs_and_flags_to_the_last_bit(variant):
    task = pemirl_envs.get_task(f"sawyer_pusher/{variant}")
    plain = task.build_spec()
    # Islands are solved one by one: the same motion, but for the order of additions.
    plain.option.disableflags = mujoco.mjtDisableBit.mjDSBL_ISLAND
    for pair in list(plain.pairs):
        plain.delete(pair)
    kinds = {"stick": (1, 0), "mug": (2, 1), "handle": (2, 1), "table": (0, 2), "wall": (0, 3)}
    for geom in plain.geoms:
        geom.contype, geom.conaffinity = kinds.get(geom.name, (0, 0))
        geom.friction = (0.4, 0.005, 0.0001)
    generator = torch.Generator().manual_seed(0)
    end = torch.tensor([0.0, 0.8, 0.035]) + 0.03 * torch.randn(12, 3, generator=generator)
    end[:, 2] = 0.035
    start = torch.tensor([0.0, 0.4, 0.05])
    targets = start + (end - start) * torch.linspace(0, 1, 40)[:, None, None]
    got, expected = play(task.model, targets), play(plain.compile(), targets)
    assert torch.equal(got, expected)
    pushed = (got[-1, :, 7:9] - got[0, :, 7:9]).norm(dim=-1) > 0.02
    assert pushed.float().mean() > 0.5  # contacts took part


def test_the_arm_has_sawyers_dimensions():
    """Stretched out: forward a1 + d3 + d5 + d7, to the side d2 - d4 + d6, up d1 (its DH table)."""
    model = pemirl_envs.get_task("sawyer_pusher/normal").model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    flange = data.body("right_l6").xpos - data.body("base").xpos
    side, forward, up = 0.1925 - 0.1685 + 0.1363, 0.081 + 0.4 + 0.4 + 0.11, 0.317
    np.testing.assert_allclose(flange, (-side, forward, up), atol=1e-3)
    links = [model.body(f"right_l{i}").mass[0] for i in range(7)]
    assert sum(links) == pytest.approx(17.0865, abs=1e-3)  # kg


def test_an_action_moves_the_hand_by_centimetres_within_its_box():
    env = pemirl_envs.make("sawyer_pusher/normal", 3, seed=0)
    data = env.reset()
    action = torch.tensor([[0.5, 0.0, 1.0], [-3.0, 0.0, 0.0], [0.0, -1.0, -1.0]])
    env.step(data.set("action", action))
    target = env.episodes.simulation.field("mocap_pos")[:, 0]
    expected = [[0.005, 0.4, 0.06], [-0.01, 0.4, 0.05], [0.0, 0.4, 0.04]]  # y cannot go below 0.4
    np.testing.assert_allclose(target, expected, atol=1e-12)
    for _ in range(5):
        env.step(data.set("action", action))
    assert target[2, 2].item() == pytest.approx(0.02)


def test_the_hand_follows_its_target():
    env = pemirl_envs.make("sawyer_pusher/normal", 8, seed=0)
    data = env.reset()
    generator = torch.Generator().manual_seed(0)
    direction = torch.randn(8, 3, generator=generator).sign()
    for step in range(120):
        if step % 30 == 0:
            direction = torch.randn(8, 3, generator=generator).sign()
        action = direction if step < 100 else torch.zeros(8, 3)
        data = env.step(data.set("action", action))["next"].exclude("reward")
        target = env.episodes.simulation.field("mocap_pos")[:, 0]
        assert (data["observation"][:, :3] - target).norm(dim=-1).max() < 0.04
    assert (data["observation"][:, :3] - target).norm(dim=-1).max() < 0.015


def test_episodes_begin_at_rest_with_the_mug_near_its_place():
    env = pemirl_envs.make("sawyer_pusher/normal", 3000, seed=0)
    first = env.reset()["observation"]
    np.testing.assert_allclose(first[:, :3], np.tile((0.0, 0.4, 0.05), (3000, 1)), atol=1e-3)
    for axis, centre in ((3, 0.0), (4, 0.6)):
        law = scipy.stats.uniform(centre - 0.02, 0.04)
        assert scipy.stats.kstest(first[:, axis].double().numpy(), law.cdf).pvalue > 0.01
    few = pemirl_envs.make("sawyer_pusher/normal", 4, seed=0)
    data = few.reset()
    step = few.step(data.clone().set("action", torch.zeros(4, 3)))
    moved = step["next", "observation"] - data["observation"]
    assert moved.abs().max() < 1e-5


def test_reward_by_hand():
    env = pemirl_envs.make("sawyer_pusher/normal", 2, seed=0)
    goal = torch.tensor([[0.3, 0.8], [-0.2, 1.0]])
    data = env.reset(env.reset().update({"task": {"goal": goal}}))
    step = env.rand_step(data.clone())
    for i in range(2):
        hand, mug = data["observation"][i, :3].tolist(), data["observation"][i, 3:6].tolist()
        expected = -math.dist(hand, mug) - math.dist(mug[:2], goal[i].tolist())
        assert step["next", "reward"][i].item() == pytest.approx(expected, abs=1e-6)


def test_the_shift_adds_a_wall_alone():
    specs = [pemirl_envs.get_task(f"sawyer_pusher/{v}").build_spec() for v in ("normal", "shift")]
    for spec in specs:
        spec.compile()
    wall = specs[1].geom("wall")
    assert (wall.pos[0] - wall.size[0], wall.pos[0] + wall.size[0]) == pytest.approx((-0.1, 0.45))
    for pair in list(specs[1].pairs):
        if "wall" in (pair.geomname1, pair.geomname2):
            specs[1].delete(pair)
    specs[1].delete(wall)
    assert specs[0].to_xml() == specs[1].to_xml()


def test_a_blocked_hand_keeps_its_target_near():
    """Pressed against the wall for 10 s, the target would otherwise run on to its box's end."""
    env = pemirl_envs.make("sawyer_pusher/shift", 2, seed=0)
    data = env.reset()
    ahead = torch.tensor([[0.0, 1.0, -0.2], [0.3, 1.0, -0.2]])
    lag = []
    for _ in range(env.task.horizon):
        data = env.step(data.set("action", ahead))["next"].exclude("reward", "done", "truncated")
        target = env.episodes.simulation.field("mocap_pos")[:, 0]
        lag.append((target - data["observation"][:, :3]).abs().max().item())
    assert data["observation"][:, 1].max() < 0.7  # the wall's centre line
    assert 0.04 < max(lag) < 0.06


@pytest.mark.parametrize("spin", [100.0, 1000.0])
def test_a_mug_that_is_squeezed_out_spinning_does_not_break_the_simulation(spin):
    """Unequal inertias without drag gain energy: 1e6 rad/s after a few steps, then BADQACC."""
    task = pemirl_envs.get_task("sawyer_pusher/shift")
    goal = {"goal": torch.tensor([[0.0, 0.9]])}
    batch = MujocoBatch(task.model, 1, 1)
    state = task.initial_state(goal, torch.Generator().manual_seed(0))
    state["qpos"][:, 9] = 2.0  # aloft
    state["qvel"] = torch.zeros(1, task.model.nv, dtype=torch.float64)
    state["qvel"][:, 10:13] = torch.tensor([spin, spin / 3, spin / 2], dtype=torch.float64)
    batch.write(state)
    fastest = 0.0
    for _ in range(60):
        assert not batch.step(1)
        fastest = max(fastest, float(batch.field("qvel")[:, 10:13].abs().max()))
    assert fastest < 1.5 * spin
