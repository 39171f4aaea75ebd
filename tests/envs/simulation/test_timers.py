"""MuJoCo's clock is off while a batch steps, and back afterwards."""

import threading

import mujoco
import numpy as np
import pytest

from pemirl_envs import get_task
from pemirl_envs.simulation.mujoco_batch import MujocoBatch
from pemirl_envs.simulation.timers import timers_off


def calls_of_the_clock(action) -> int:
    """How often MuJoCo reads its clock in the meantime."""
    calls = 0

    def clock() -> float:
        nonlocal calls
        calls += 1
        return 0.0

    mujoco.set_mjcb_time(clock)
    try:
        action()
    finally:
        mujoco.set_mjcb_time(None)
    return calls


def test_a_step_of_mujoco_reads_the_clock_and_without_timers_it_does_not():
    model = get_task("point_maze/left").model
    data = mujoco.MjData(model)

    def step() -> None:
        mujoco.mj_step(model, data)

    def untimed() -> None:
        with timers_off():
            step()

    assert calls_of_the_clock(step) > 0
    assert calls_of_the_clock(untimed) == 0
    assert calls_of_the_clock(step) > 0  # it is back


def test_a_batch_steps_untimed_and_to_the_same_state():
    model = get_task("point_maze/left").model
    batch, data = MujocoBatch(model, 2, 1), mujoco.MjData(model)
    assert calls_of_the_clock(lambda: batch.step(5)) == 0
    for _ in range(5):
        mujoco.mj_step(model, data)
    row = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
    np.testing.assert_array_equal(batch.state.numpy(), np.stack([row, row]))


def test_the_clock_is_back_after_an_error():
    with pytest.raises(RuntimeError, match="stop"), timers_off():
        raise RuntimeError("stop")
    model = get_task("point_maze/left").model
    assert calls_of_the_clock(lambda: mujoco.mj_step(model, mujoco.MjData(model))) > 0


def test_a_clock_in_python_reaches_no_call_of_a_batch():
    """A batch refuses Python functions as callbacks; a profiler's clock is one."""
    task = get_task("sweeper/normal")  # it computes derived fields, too
    model = task.model  # compiling reads the clock

    def use() -> None:
        batch = MujocoBatch(model, 2, 2, task.stage)
        batch.reset()
        batch.field("site_xpos")
        batch.write({"qpos": batch.field("qpos").clone()})
        batch.step(1)

    assert calls_of_the_clock(use) == 0


def test_the_clock_is_back_after_the_last_of_several_threads():
    """They overlap: the second begins before the first ends, and ends after it."""
    inside, go_on = threading.Event(), threading.Event()

    def second() -> None:
        with timers_off():
            inside.set()
            go_on.wait(10)

    def overlap() -> None:
        thread = threading.Thread(target=second)
        with timers_off():
            thread.start()
            inside.wait(10)
        go_on.set()
        thread.join()
        mujoco.mj_step(model, mujoco.MjData(model))

    model = get_task("point_maze/left").model
    assert calls_of_the_clock(overlap) > 0


def test_other_callbacks_in_python_are_named():
    batch = MujocoBatch(get_task("point_maze/left").model, 2, 1)
    before = batch.state
    mujoco.set_mjcb_control(lambda model, data: None)
    try:
        with pytest.raises(ValueError, match="mjcb_control is a Python function"):
            batch.step(1)
    finally:
        mujoco.set_mjcb_control(None)
    np.testing.assert_array_equal(batch.state, before)
    assert batch.step(1) == {}
