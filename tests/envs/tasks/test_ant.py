import mujoco
import numpy as np
import pytest
import scipy.stats
import torch

import pemirl_envs
from pemirl_envs.simulation import MujocoBatch
from pemirl_envs.tasks.ant import VARIANTS, Ant, upright

every_variant = pytest.mark.parametrize("variant", VARIANTS)

# As its authors wrote it (justinjfu/inverse_rl, envs/ant_env.py), but for the margin, which MuJoCo
# now adds for the two geoms, where older versions took the larger one, 0.01.
AUTHORS_MODEL = """
<mujoco>
  <option timestep="0.01" integrator="{integrator}"/>
  <default>
    <joint armature="1" damping="1" limited="true"/>
    <geom friction="1.5 0.5 0.5" density="5" margin="0.005" condim="3" conaffinity="0"/>
    <motor ctrllimited="true" ctrlrange="-1 1"/>
  </default>
  <worldbody>
    <geom conaffinity="1" size="40 40 40" type="plane"/>
    <body name="torso" pos="0 0 0.75">
      <geom size="0.25" type="sphere"/>
      <joint armature="0" damping="0" limited="false" margin="0.01" type="free"/>
      <geom fromto=".07 0 .1 .07 -.21 .1" size="0.03" type="capsule"/>
      <geom fromto=".07 0 .1 .07 -.23 .1" size="0.02" type="capsule"/>
      <geom fromto="-.07 0 .1 -.07 -.21 .1" size="0.03" type="capsule"/>
      <geom fromto="-.07 0 .1 -.07 -.23 .1" size="0.02" type="capsule"/>
      <geom fromto=".04 -.21 .17 .1 -.21 .2" size="0.02" type="capsule"/>
      <geom fromto="-.04 -.21 .17 -.1 -.21 .2" size="0.02" type="capsule"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
AUTHORS_LEG = """
<body>
  <geom fromto="0 0 0 {aux}" size="0.08" type="capsule"/>
  <body pos="{aux}">
    <joint axis="0 0 1" name="hip_{i}" range="-30 30" type="hinge"/>
    <geom fromto="0 0 0 {thigh}" size="0.08" type="capsule"/>
    <body pos="{thigh}">
      <joint axis="{axis}" name="ankle_{i}" range="{range}" type="hinge"/>
      <geom fromto="0 0 0 {shin}" size="0.08" type="capsule"/>
    </body>
  </body>
</body>
"""
AUTHORS_LEGS = {  # quadrant, ankle axis, ankle range
    1: ((1, 1), "-1 1 0", "30 70"),
    2: ((-1, 1), "1 1 0", "-70 -30"),
    3: ((-1, -1), "-1 1 0", "-70 -30"),
    4: ((1, -1), "1 1 0", "30 70"),
}
DISABLED_LEGS = {
    "normal": (),
    "disabled": (3, 4),
    "disabled_left": (2, 3),
    "disabled_diagonal": (1, 3),
    "disabled_one": (2,),
}
AUTHORS_ORDER = {False: (4, 1, 2, 3), True: (1, 2, 3, 4)}  # of the legs' motors, by disabled


def authors_model(disabled, integrator):
    legs, motors = [], []
    for i, ((x, y), axis, limits) in AUTHORS_LEGS.items():
        thigh, shin = (0.1, 0.2) if disabled and i > 2 else (0.2, 0.4)
        ends = {"aux": 0.2, "thigh": thigh, "shin": shin}
        ends = {part: f"{x * size} {y * size} 0" for part, size in ends.items()}
        legs.append(AUTHORS_LEG.format(i=i, axis=axis, range=limits, **ends))
    for i in AUTHORS_ORDER[disabled]:
        gear = 1 if disabled and i > 2 else 30
        motors += [f'<motor joint="{joint}_{i}" gear="{gear}"/>' for joint in ("hip", "ankle")]
    xml = AUTHORS_MODEL.format(integrator=integrator, legs="".join(legs), motors="".join(motors))
    return mujoco.MjModel.from_xml_string(xml)


def walk(model, start, controls):
    """States [T, N, 29] from start (State of [N, ...]) under controls [T, N, 8]."""
    batch = MujocoBatch(model, controls.shape[1], num_threads=1)
    batch.write(start)
    states = []
    for control in controls:
        batch.write({"ctrl": control})
        batch.step(Ant.n_sub_steps)
        states.append(torch.cat([batch.field("qpos"), batch.field("qvel")], -1))
    return torch.stack(states)


def starts(n, seed=0):
    generator = torch.Generator().manual_seed(seed)
    task = Ant()
    return task.initial_state(task.sample_parameters(n, "train", generator), generator)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("disabled", [False, True])
def test_moves_as_the_authors_model_to_the_last_bit(disabled, integrator):
    """With pairs and flags here, and masks there; upside down and on its feet."""
    n = 12
    start = starts(n)
    start["qpos"][:4, 3:7] = torch.tensor([0.0, 0.0, 1.0, 0.0])  # on its back
    torques = torch.rand(50, n, 8, generator=torch.Generator().manual_seed(1)) * 2 - 1
    reference = authors_model(disabled, integrator)
    order = [2 * (leg - 1) + joint for leg in AUTHORS_ORDER[disabled] for joint in (0, 1)]
    states = walk(Ant(disabled=disabled, integrator=integrator).model, start, torques)
    assert torch.equal(states, walk(reference, start, torques[..., order]))
    assert (upright(states[-1]) < 0).any()
    assert (upright(states[-1]) > 0).any()


@every_variant
def test_one_order_of_motors_and_mass_of_each_body(variant):
    model = pemirl_envs.get_task(f"ant/{variant}").model
    data = mujoco.MjData(model)
    data.ctrl[:] = np.linspace(0.1, 0.8, 8)
    mujoco.mj_forward(model, data)
    legs = DISABLED_LEGS[variant.removesuffix("_rk4")]
    gear = np.repeat([1 if leg in legs else 30 for leg in (1, 2, 3, 4)], 2)
    np.testing.assert_allclose(data.qfrc_actuator[6:], gear * data.ctrl, rtol=1e-15)
    assert model.body_mass.sum() == pytest.approx(0.9224 - 0.0427 * len(legs), abs=5e-4)


def test_a_leg_that_is_not_there_cannot_be_disabled():
    with pytest.raises(ValueError, match=r"no leg \[5\]"):
        Ant(disabled=(1, 5))


def test_disabling_changes_the_two_front_legs_alone():
    healthy, disabled = Ant().model, Ant(disabled=True).model
    for i in range(healthy.ngeom):
        name = healthy.geom(i).name
        ratio = disabled.geom_size[i, 1] / max(healthy.geom_size[i, 1], 1e-12)
        short = name in {"thigh_3", "shin_3", "thigh_4", "shin_4"}
        assert ratio == pytest.approx(0.5 if short else 1.0) or name == "torso"
    for eye in ("eye_left", "eye_right"):
        assert healthy.geom(eye).pos[1] < 0
    for leg in (3, 4):
        assert healthy.body(f"thigh_{leg}").pos[1] < 0


@pytest.mark.parametrize("variant", ["normal", "disabled"])
def test_forward_and_backward_are_mirror_images(variant):
    """The reflection x -> -x swaps legs 1 and 2, 3 and 4, and the two tasks."""
    task, n = pemirl_envs.get_task(f"ant/{variant}"), 16
    swapped = [2, 3, 0, 1, 6, 7, 4, 5]

    def mirrored(position, velocity):
        joints = [-x[:, a:][:, swapped] for x, a in ((position, 7), (velocity, 6))]
        flip = torch.tensor([-1.0, 1, 1, 1, 1, -1, -1]), torch.tensor([-1.0, 1, 1, 1, -1, -1])
        return (
            torch.cat([position[:, :7] * flip[0], joints[0]], -1),
            torch.cat([velocity[:, :6] * flip[1], joints[1]], -1),
        )

    start = starts(n)
    position, velocity = mirrored(start["qpos"], start["qvel"])
    torques = torch.rand(10, n, 8, generator=torch.Generator().manual_seed(1)) * 2 - 1
    states = walk(task.model, start, torques)
    images = walk(task.model, {"qpos": position, "qvel": velocity}, -torques[..., swapped])
    for state, image in zip(states, images, strict=True):
        expected = torch.cat(mirrored(state[:, :15], state[:, 15:]), -1)
        torch.testing.assert_close(image, expected, rtol=0, atol=1e-7)
    action, rewards = torch.zeros(n, 8), []
    for state, direction in ((states[-1], 1.0), (images[-1], -1.0)):
        fields = {"qpos": state[:, :15], "qvel": state[:, 15:]}.__getitem__
        rewards.append(task.reward(fields, action, {"direction": torch.full((n, 1), direction)}))
    torch.testing.assert_close(rewards[0], rewards[1], rtol=0, atol=1e-6)


def test_reward_by_hand():
    env = pemirl_envs.make("ant/normal", 4, seed=0)
    direction = torch.tensor([[1.0], [-1.0], [1.0], [-1.0]])
    data = env.reset(env.reset().update({"task": {"direction": direction}}))
    simulation = env.episodes.simulation
    qpos, qvel = simulation.field("qpos").clone(), torch.zeros(4, 14)
    qpos[:, 3:7] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    qpos[2, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])  # on its back
    qpos[3, 3:7] = torch.tensor([0.6, 0.0, 0.8, 0.0])  # 106 degrees about y
    qvel[:, 0] = torch.tensor([1.5, 1.5, -0.5, -0.5])
    simulation.write({"qpos": qpos, "qvel": qvel})
    action = torch.zeros(4, 8)
    action[0, 0], action[1, 1] = 0.5, -3.0  # the second is clipped to -1
    reward = env.step(data.set("action", action))["next", "reward"][:, 0]
    expected = [1.5 - 0.01 * 0.25, -1.5 - 0.01, -0.5 - 1, 0.5 - 1]
    np.testing.assert_allclose(reward, expected, rtol=0, atol=1e-6)


def test_the_penalty_fires_for_an_ant_that_fell_on_its_back():
    """The authors test z < 0.2, which a torso of radius 0.25 cannot reach."""
    env = pemirl_envs.make("ant/normal", 8, seed=0)
    data = env.reset()
    position = env.episodes.simulation.field("qpos").clone()
    position[:, 3:7] = torch.tensor([0.0, 0.0, 1.0, 0.0])
    env.episodes.simulation.write({"qpos": position, "qvel": torch.zeros(8, 14)})
    for _ in range(60):
        data = env.step(data.set("action", torch.zeros(8, 8)))["next"].exclude("reward")
    reward = env.step(data.set("action", torch.zeros(8, 8)))["next", "reward"]
    assert (env.episodes.simulation.field("qpos")[:, 2] > 0.2).all()
    np.testing.assert_allclose(reward, -1.0, atol=0.3)  # but for the speed that it has left


def test_upright_is_the_z_component_of_the_up_axis():
    rotation = scipy.stats.special_ortho_group.rvs(3, size=20, random_state=0)
    w_last = scipy.spatial.transform.Rotation.from_matrix(rotation).as_quat()
    qpos = torch.zeros(20, 15, dtype=torch.float64)
    qpos[:, 3:7] = torch.from_numpy(np.roll(w_last, 1, axis=1))
    np.testing.assert_allclose(upright(qpos), rotation[:, 2, 2], atol=1e-12)


def test_the_observation_is_the_state_without_x_and_y():
    env = pemirl_envs.make("ant/normal", 3, seed=0)
    state = env.rollout(4)["next", "observation"][:, -1]
    simulation = env.episodes.simulation
    expected = torch.cat([simulation.field("qpos")[:, 2:], simulation.field("qvel")], -1).float()
    assert torch.equal(state, expected)


def test_initial_states_are_distributed_as_the_authors():
    state = starts(4000)
    offset = state["qpos"] - torch.from_numpy(Ant().model.qpos0)
    uniform, normal = scipy.stats.uniform(-0.1, 0.2), scipy.stats.norm(0, 0.1)
    for coordinate in (0, 1, 2, *range(7, 15)):
        assert scipy.stats.kstest(offset[:, coordinate].numpy(), uniform.cdf).pvalue > 1e-3
    for coordinate in range(14):
        assert scipy.stats.kstest(state["qvel"][:, coordinate].numpy(), normal.cdf).pvalue > 1e-3
    torch.testing.assert_close(state["qpos"][:, 3:7].norm(dim=-1), torch.ones(4000).double())
    # The offset of the quaternion, up to its length.
    quaternion = state["qpos"][:, 3:7]
    assert (quaternion[:, 1:].abs() <= 0.1 / 0.9).all()
    assert 0.9 < quaternion[:, 1:].abs().max() / (0.1 / 0.9) <= 1


@pytest.mark.parametrize("split", ["train", "validation", "test", "confirm"])
def test_every_split_is_both_directions(split):
    directions = pemirl_envs.task_parameters("ant/disabled", split)["direction"]
    assert directions.tolist() == [[1.0], [-1.0]]
    drawn = pemirl_envs.make("ant/normal", 400, split=split, seed=0).reset()["task", "direction"]
    assert set(drawn.flatten().tolist()) == {1.0, -1.0}
    assert scipy.stats.binomtest(int((drawn > 0).sum()), 400).pvalue > 1e-3


def test_the_faces_draw_from_both_directions_by_default():
    assert pemirl_envs.make("ant/normal").episodes.split == "train"
    env = pemirl_envs.load("ant", "normal", task_kwargs={"random": 0})
    drawn = set()
    for _ in range(20):
        env.reset()
        drawn.add(env.task.parameters["direction"].item())
    assert drawn == {1.0, -1.0}


@pytest.mark.parametrize("illegal", [0.0, 0.5, -2.0, float("nan")])
def test_other_directions_are_refused(illegal):
    env = pemirl_envs.make("ant/normal", 3, seed=0)
    given = env.reset().update({"task": {"direction": torch.tensor([[1.0], [illegal], [-1.0]])}})
    with pytest.raises(ValueError, match=r"direction of simulation\(s\) \[1\].* legal values"):
        env.reset(given)
    masked = torch.tensor([[True], [False], [True]])
    env.reset(given.set("_reset", masked))  # the illegal one takes no part


@pytest.mark.parametrize("split", ["train_100", "nonsense"])
def test_unknown_splits_are_refused(split):
    with pytest.raises(ValueError, match=f"'{split}' is not a finite split; expected one of"):
        pemirl_envs.task_parameters("ant/normal", split)
    with pytest.raises(ValueError, match=f"unknown split '{split}'; expected one of"):
        Ant().sample_parameters(1, split, torch.Generator())


def test_components_are_where_the_state_has_them():
    env = pemirl_envs.make("ant/normal", 3, seed=0)
    observation, simulation = env.reset()["observation"], env.episodes.simulation
    qpos, qvel = simulation.field("qpos").float(), simulation.field("qvel").float()
    places = {
        "torso_height": qpos[:, 2:3],
        "torso_orientation": qpos[:, 3:7],
        "joint_angles": qpos[:, 7:],
        "torso_velocity_xy": qvel[:, :2],
        "torso_velocity_z": qvel[:, 2:3],
        "torso_angular_velocity": qvel[:, 3:6],
        "joint_velocities": qvel[:, 6:],
    }
    for name, expected in places.items():
        assert torch.equal(observation[:, env.task.component_slice(name)], expected)


def test_the_speed_is_the_mean_along_the_direction():
    observation = torch.full((2, 4, 27), 100.0)
    observation[:, :, 13] = torch.tensor([1.0, 2.0, 3.0, 6.0])
    speed = Ant.outcomes["speed_m_per_s"](observation, {"direction": torch.tensor([[1.0], [-1.0]])})
    assert speed.tolist() == [3.0, -3.0]
