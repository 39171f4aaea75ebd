import math

import mujoco
import numpy as np
import pytest
import scipy.stats
import torch

import pemirl_envs
from pemirl_envs.simulation import MujocoBatch
from pemirl_envs.tasks import point_maze
from pemirl_envs.tasks.point_maze import PointMaze

BARRIERS = {"left": "-.1 .3 .01 .4 .3 .01", "right": ".2 .3 .01 .6 .3 .01"}

# As the authors wrote it (ermongroup/MetaIRL, dynamic_mjc/mjc_models.py), but for the margin:
# MuJoCo now adds the margins of two geoms, where older versions took the larger one, 0.002.
AUTHORS_MODEL = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0" iterations="20" integrator="Euler"/>
  <default>
    <joint damping="1"/>
    <geom friction=".5 .1 .1" density="1000" margin="0.001" condim="1" contype="2" conaffinity="1"/>
  </default>
  <worldbody>
    <body name="particle" pos="0.3 0 0">
      <geom type="sphere" size="0.03" contype="1"/>
      <joint name="ball_x" type="slide" axis="1 0 0"/>
      <joint name="ball_y" type="slide" axis="0 1 0"/>
    </body>
    <geom type="capsule" size="0.02" fromto="-.1 -.1 .01 .6 -.1 .01"/>
    <geom type="capsule" size="0.02" fromto=".6 -.1 .01 .6 .6 .01"/>
    <geom type="capsule" size="0.02" fromto="-.1 .6 .01 .6 .6 .01"/>
    <geom type="capsule" size="0.02" fromto="-.1 -.1 .01 -.1 .6 .01"/>
    <geom type="capsule" size="0.02" fromto="{barrier}"/>
  </worldbody>
  <actuator>
    <motor joint="ball_x" ctrlrange="-1 1" ctrllimited="true"/>
    <motor joint="ball_y" ctrlrange="-1 1" ctrllimited="true"/>
  </actuator>
</mujoco>
"""


def push(model, controls):
    """Positions [T, N, 2] under controls [T, N, 2]."""
    batch = MujocoBatch(model, controls.shape[1], num_threads=1)
    positions = []
    for control in controls:
        batch.write({"ctrl": control})
        batch.step(PointMaze.n_sub_steps)
        positions.append(batch.field("qpos").clone())
    return torch.stack(positions)


@pytest.mark.parametrize("variant", BARRIERS)
def test_moves_as_the_authors_model_to_the_last_bit(variant):
    reference = mujoco.MjModel.from_xml_string(AUTHORS_MODEL.format(barrier=BARRIERS[variant]))
    generator = torch.Generator().manual_seed(0)
    drift = torch.rand(1, 40, 2, generator=generator) * 2 - 1
    controls = (drift + torch.randn(100, 40, 2, generator=generator)).clamp(-1, 1)
    positions = push(pemirl_envs.get_task(f"point_maze/{variant}").model, controls)
    assert torch.equal(positions, push(reference, controls))
    assert (positions[-1, :, 1] > 0.3).any()  # some went around the barrier


@pytest.mark.parametrize(
    ("name", "blocked", "free", "barrier_y"),
    [
        ("left", 0.3, 0.52, 0.3),
        ("right", 0.3, 0.08, 0.3),
        ("stochastic", 0.3, 0.08, 0.5),
        ("stochastic_left", 0.3, 0.52, 0.5),
    ],
)
def test_the_barrier_stops_and_its_gap_lets_pass(name, blocked, free, barrier_y):
    batch = MujocoBatch(pemirl_envs.get_task(f"point_maze/{name}").model, 2, num_threads=1)
    batch.write({"qpos": torch.tensor([[blocked - 0.3, 0.0], [free - 0.3, 0.0]])})
    batch.write({"ctrl": torch.tensor([[0.0, 1.0], [0.0, 1.0]])})
    batch.step(500)
    y = batch.field("qpos")[:, 1]
    # The particle (3 cm) rests on the barrier or on the top wall (2 cm), but for soft contacts.
    assert y[0] == pytest.approx(barrier_y - 0.05, abs=0.005)
    assert y[1] == pytest.approx(2 * barrier_y - 0.05, abs=0.005)


def test_reward_by_hand():
    env = pemirl_envs.make("point_maze/left", 2, seed=0)
    goal = torch.tensor([[0.3, 0.5], [0.1, 0.5]])
    data = env.reset(env.reset().update({"task": {"goal": goal}}))
    action = torch.tensor([[0.5, -0.25], [3.0, 0.0]])  # the second is clipped to (1, 0)
    step = env.step(data.clone().set("action", action))
    for i, cost in enumerate((0.001 * (0.25 + 0.0625), 0.001)):
        x, y = data["observation"][i].tolist()
        expected = -math.hypot(x - goal[i, 0].item(), y - goal[i, 1].item()) - cost
        assert step["next", "reward"][i].item() == pytest.approx(expected, abs=1e-7)
    assert torch.equal(step["action"], action)  # data keep what the policy chose


def test_episodes_begin_near_the_start_at_rest():
    env = pemirl_envs.make("point_maze/left", 4000, seed=0)
    offset = env.reset()["observation"] - torch.tensor([0.3, 0.0])
    velocity = env.episodes.simulation.field("qvel")
    for values, half_width in ((offset.double(), 0.05), (velocity, 0.01)):
        uniform = scipy.stats.uniform(-half_width, 2 * half_width)
        for axis in range(2):
            assert scipy.stats.kstest(values[:, axis].numpy(), uniform.cdf).pvalue > 0.01


def test_goals_of_the_authors_training_set():
    goals = pemirl_envs.task_parameters("point_maze/left", "train")["goal"]
    expected = [(x, 0.5) for x in np.arange(0.0, 0.5, 0.04)]
    np.testing.assert_allclose(goals, expected, rtol=0, atol=1e-7)


def test_continuous_goals_are_distributed_as_the_authors():
    rng = np.random.default_rng(0)
    expected = rng.normal(rng.choice([0.1, 0.3, 0.5], 40_000), 0.05)
    expected = expected[(expected >= 0.0) & (expected <= 0.6)]
    generator = torch.Generator().manual_seed(0)
    goal = PointMaze().sample_parameters(40_000, "continuous", generator)["goal"]
    assert scipy.stats.ks_2samp(goal[:, 0].numpy(), expected).pvalue > 0.01
    assert (goal[:, 1] == 0.5).all()


def test_fixed_task_sets():
    train = pemirl_envs.task_parameters("point_maze/right", "train_100")["goal"]
    test = pemirl_envs.task_parameters("point_maze/right", "test")["goal"]
    validation = pemirl_envs.task_parameters("point_maze/right", "validation")["goal"]
    confirm = pemirl_envs.task_parameters("point_maze/right", "confirm")["goal"]
    assert (len(train), len(validation), len(test), len(confirm)) == (100, 15, 30, 30)
    # No goal is in two of them.
    assert len(torch.cat([train, validation, test, confirm])[:, 0].unique()) == 175
    # Demonstrations and published results refer to these goals: they may never change.
    assert test[:3, 0].tolist() == pytest.approx([0.2474077, 0.5082107, 0.5578249])
    assert train[:3, 0].tolist() == pytest.approx([0.4845742, 0.3523841, 0.4748982])
    assert validation[:3, 0].tolist() == pytest.approx([0.4873493, 0.2488809, 0.5499175])
    assert confirm[:3, 0].tolist() == pytest.approx([0.0590334, 0.4813827, 0.5593777])
    tall = pemirl_envs.task_parameters("point_maze/stochastic", "test")["goal"]
    assert torch.equal(tall[:, 0], test[:, 0])
    assert tall[:, 1].tolist() == pytest.approx([0.9] * 30)


@pytest.mark.parametrize("split", ["train", "train_100", "validation", "test", "confirm"])
def test_resets_draw_from_the_whole_split(split):
    env = pemirl_envs.make("point_maze/left", 2000, split=split, seed=0)
    drawn = {tuple(goal) for goal in env.reset()["task", "goal"].tolist()}
    legal = pemirl_envs.task_parameters("point_maze/left", split)["goal"].tolist()
    assert drawn == {tuple(goal) for goal in legal}


def test_transition_noise_has_a_standard_deviation_of_one_centimetre():
    n = 4000
    noisy = pemirl_envs.make("point_maze/stochastic", n, seed=0)
    still = pemirl_envs.TaskEnv(PointMaze("right", 1.0), n, seed=0)
    moved = [
        env.step(env.reset().set("action", torch.zeros(n, 2)))["next", "observation"].double()
        for env in (noisy, still)
    ]
    noise = (moved[0] - moved[1]).flatten().numpy()
    assert scipy.stats.kstest(noise, scipy.stats.norm(0, 0.01).cdf).pvalue > 0.01


def test_transition_noise_does_not_push_through_walls():
    env = pemirl_envs.make("point_maze/stochastic", 200, seed=0)
    up = torch.tensor([0.3, 1.0]).expand(200, 2)  # against the barrier, whose gap is on the left
    data = env.rollout(100, lambda td: td.set("action", up), break_when_any_done=False)
    assert data["next", "observation"][..., 1].max() < 0.5
    assert data["next", "observation"][..., 0].max() < 0.6


def test_the_layout_is_that_of_the_model():
    for name in (f"point_maze/{variant}" for variant in point_maze.VARIANTS):
        plan, model = pemirl_envs.layout(name), pemirl_envs.get_task(name).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert set(plan.walls) == {"south", "east", "north", "west", "barrier"}
        for wall, ends in plan.walls.items():
            i = model.geom(wall).id
            half = data.geom_xmat[i].reshape(3, 3)[:, 2] * model.geom_size[i, 1]
            got = sorted([data.geom_xpos[i] - half, data.geom_xpos[i] + half], key=tuple)
            np.testing.assert_allclose(np.array(got)[:, :2], sorted(ends), atol=1e-9)
            assert model.geom_size[i, 0] == plan.wall_radius
        np.testing.assert_allclose(data.body("particle").xpos[:2], plan.start)
    assert (plan.low, plan.high) == ((-0.1, -0.1), (0.6, 1.0))


def test_the_shift_moves_the_barrier_alone():
    left, right = (pemirl_envs.layout(f"point_maze/{side}") for side in BARRIERS)
    assert left.walls.pop("barrier") == ((-0.1, 0.3), (0.4, 0.3))
    assert right.walls.pop("barrier") == ((0.2, 0.3), (0.6, 0.3))
    assert left == right


@pytest.mark.parametrize("split", ["uniform", "continuous", "nonsense"])
def test_endless_and_unknown_splits_have_no_task_set(split):
    with pytest.raises(ValueError, match=rf"'{split}' is not a finite split; expected one of"):
        pemirl_envs.task_parameters("point_maze/left", split)


def test_an_unknown_split_is_refused():
    with pytest.raises(ValueError, match="unknown split 'nonsense'; expected one of"):
        PointMaze().sample_parameters(1, "nonsense", torch.Generator())
