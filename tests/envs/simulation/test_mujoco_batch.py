import mujoco
import numpy as np
import pytest
import torch

from pemirl_envs import get_task
from pemirl_envs.simulation import MujocoBatch, SimulationError, available_cpus

N_SUB_STEPS = 5

PENDULUM = mujoco.MjModel.from_xml_string("""
<mujoco>
  <worldbody>
    <body name="pole">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -1" size=".05"/>
      <site name="tip" pos="0 0 -1"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" ctrlrange="-1 1" ctrllimited="true"/></actuator>
</mujoco>
""")


@pytest.fixture
def model():
    return get_task("point_maze/left").model


def random_controls(steps, num_sims, seed=0):
    return torch.rand(steps, num_sims, 2, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def run(batch, controls):
    for control in controls:
        batch.write({"ctrl": control})
        assert batch.step(N_SUB_STEPS) == {}
    return batch.state


def test_equals_a_loop_of_mj_step_to_the_last_bit(model):
    controls = random_controls(60, 3)
    state = run(MujocoBatch(model, 3, num_threads=2), controls)
    data = mujoco.MjData(model)
    for i in range(3):
        mujoco.mj_resetData(model, data)
        for control in controls[:, i].double().numpy():
            data.ctrl[:] = control
            mujoco.mj_step(model, data, N_SUB_STEPS)
        expected = np.empty(state.shape[1])
        mujoco.mj_getState(model, data, expected, mujoco.mjtState.mjSTATE_INTEGRATION)
        assert torch.equal(state[i], torch.from_numpy(expected))


def test_results_do_not_depend_on_the_number_of_threads(model):
    controls = random_controls(30, 16)
    states = [run(MujocoBatch(model, 16, num_threads=n), controls) for n in (1, 2, 5)]
    assert torch.equal(states[0], states[1])
    assert torch.equal(states[0], states[2])


def test_threads_default_to_the_usable_cpus_and_never_exceed_the_simulations(model):
    assert MujocoBatch(model, 10_000).num_threads == available_cpus()
    assert MujocoBatch(model, 2, num_threads=8).num_threads == 2


def test_reset_and_write_touch_the_mask_alone(model):
    batch = MujocoBatch(model, 4, num_threads=1)
    before = run(batch, random_controls(5, 4))
    mask = torch.tensor([True, False, False, True])
    batch.reset(mask)
    batch.write({"qpos": torch.full((4, 2), 0.125)}, mask)
    assert torch.equal(batch.state[~mask], before[~mask])
    assert (batch.field("qpos")[mask] == 0.125).all()
    assert (batch.field("time")[mask] == 0).all()


def test_state_is_a_copy(model):
    batch = MujocoBatch(model, 2, num_threads=1)
    state = batch.state
    state.fill_(1.0)
    assert (batch.field("qpos") == 0).all()


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e12])
def test_a_diverging_simulation_is_named_and_keeps_its_state(model, bad):
    controls = random_controls(4, 3)
    batch, twin = (MujocoBatch(model, 3, num_threads=1) for _ in range(2))
    for each in (batch, twin):
        run(each, controls[:2])
    ill = torch.tensor([False, True, False])
    batch.write({"qvel": torch.full((3, 2), bad)}, ill)
    before = batch.state
    batch.write({"ctrl": controls[2]})
    twin.write({"ctrl": controls[2]})
    failures = batch.step(N_SUB_STEPS)
    assert failures.keys() == {1}
    assert "BADQVEL" in failures[1] or "BADQACC" in failures[1]
    twin.step(N_SUB_STEPS)
    assert torch.equal(batch.state[~ill], twin.state[~ill])
    assert batch.field("time")[1] == before[1, 0]
    assert torch.equal(batch.field("qpos")[1], before[1, 1:3])

    assert batch.step(N_SUB_STEPS).keys() == {1}  # nothing has cured it
    batch.write({"qvel": torch.zeros(3, 2)}, ill)
    assert batch.step(N_SUB_STEPS) == {}
    batch.write({"qvel": torch.full((3, 2), bad)}, ill)
    batch.reset(ill)
    assert batch.step(N_SUB_STEPS) == {}
    assert torch.isfinite(batch.state).all()


def test_a_simulation_in_which_mujoco_raises_is_named(model, monkeypatch):
    batch = MujocoBatch(model, 3, num_threads=1)
    step = batch._batch.step

    def raise_in_one(ids, *arguments):
        step(np.array([0, 2], np.int32), *arguments)
        raise mujoco.batch.SimulationError(np.array([1]), "stack overflow", 3)

    monkeypatch.setattr(batch._batch, "step", raise_in_one)
    monkeypatch.setattr(batch._batch, "error", lambda i: f"stack overflow in {i}")
    assert batch.step(N_SUB_STEPS) == {1: "stack overflow in 1"}
    assert batch.field("time").tolist() == pytest.approx([0.05, 0.0, 0.05])


def test_derived_fields_are_current_after_every_change_of_state():
    batch = MujocoBatch(PENDULUM, 2, num_threads=1, stage=mujoco.mjtStage.mjSTAGE_POS)
    data = mujoco.MjData(PENDULUM)

    def assert_current():
        for i, angle in enumerate(batch.field("qpos")):
            data.qpos[:] = angle.numpy()
            mujoco.mj_kinematics(PENDULUM, data)
            assert torch.equal(batch.field("site_xpos")[i], torch.from_numpy(data.site_xpos))

    assert_current()
    batch.write({"qpos": torch.tensor([[0.3], [-0.7]])})
    assert_current()
    batch.step(3)
    assert_current()
    batch.reset(torch.tensor([True, False]))
    assert_current()


def test_a_write_before_a_step_may_leave_derived_fields_to_the_step():
    batches = [MujocoBatch(PENDULUM, 2, 1, stage=mujoco.mjtStage.mjSTAGE_POS) for _ in range(2)]
    start = batches[0].field("site_xpos")
    for batch, refresh in zip(batches, (True, False), strict=True):
        batch.field("site_xpos")
        batch.write({"qpos": torch.full((2, 1), 0.5)}, refresh=refresh)
    assert not torch.equal(batches[0].field("site_xpos"), start)
    assert torch.equal(batches[1].field("site_xpos"), start)
    for batch in batches:
        batch.step(N_SUB_STEPS)
    assert torch.equal(batches[0].state, batches[1].state)
    assert torch.equal(batches[0].field("site_xpos"), batches[1].field("site_xpos"))


def test_a_derived_field_without_a_stage_is_refused(model):
    with pytest.raises(ValueError, match="computes no stage: pass stage="):
        MujocoBatch(model, 1).field("xpos")


def test_writing_what_is_not_state_is_refused(model):
    with pytest.raises(ValueError, match="cannot write the field 'xpos'; expected one of time"):
        MujocoBatch(model, 1).write({"xpos": torch.zeros(1)})


@pytest.mark.parametrize("counts", [(0, 1), (1, 0), (-2, 1)])
def test_counts_must_be_positive(model, counts):
    with pytest.raises(ValueError, match="num_sims >= 1 and num_threads >= 1"):
        MujocoBatch(model, *counts)


def test_the_error_lists_its_simulations_in_order():
    error = SimulationError({9: "b", 2: "a"}, partial="rows")
    assert error.indices.tolist() == [2, 9]
    assert error.partial == "rows"
    assert str(error) == "2 simulation(s) failed (2: a; 9: b)"
    assert str(SimulationError(dict.fromkeys(range(6), "x"))).endswith("4: x; ...)")
