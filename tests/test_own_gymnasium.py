"""Tasks on Gymnasium's own models: examples/own_gymnasium."""

import importlib
import json
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

ROOT = Path(__file__).parents[1]
IDS = {"reacher": "Reacher-v5", "half_cheetah": "HalfCheetah-v5"}
VARIANTS = ("reacher_action_cost", "half_cheetah_action_cost")

pytestmark = [
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    # Of Gymnasium's half_cheetah.xml, which says so to its own environment as well.
    pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass':UserWarning"),
]


@pytest.fixture
def example(monkeypatch):
    """Imports a module of the example, from a clone."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "own_gymnasium"))
    return importlib.import_module


def without_the_goal(name, env, seen):
    """What of Gymnasium's observation is not about the task, with the fingertip as it is now."""
    if name == "half_cheetah":
        return seen
    mujoco.mj_kinematics(env.model, env.data)  # its own are those of the last substep's middle
    return np.concatenate([seen[:4], seen[6:8], env.get_body_com("fingertip")[:2]])


@pytest.mark.parametrize("name", IDS)
def test_it_is_gymnasium_s_environment_step_for_step(example, name):
    ours = example(name).make_env(1, 0)
    theirs = gymnasium.make(IDS[name]).unwrapped
    data = ours.reset()
    theirs.reset(seed=0)
    state = ours.episodes.simulation
    theirs.set_state(state.field("qpos")[0].numpy(), state.field("qvel")[0].numpy())
    generator = torch.Generator().manual_seed(0)
    low, high = ours.task.action_bounds
    for _ in range(ours.task.horizon):
        action = low + (high - low) * torch.rand(1, len(low), generator=generator)
        data = ours.step(data.set("action", action))["next"].exclude("reward")
        seen = theirs.step(action[0].numpy())[0]
        expected = without_the_goal(name, theirs, seen).astype(np.float32)
        assert np.array_equal(data["observation"][0].numpy(), expected)


@pytest.mark.parametrize("name", IDS)
def test_the_reward_is_that_of_gymnasium_for_the_state_that_is_left(example, name):
    ours = example(name).make_env(1, 0)
    data = ours.reset()
    theirs = gymnasium.make(IDS[name]).unwrapped
    theirs.reset(seed=0)
    simulation = ours.episodes.simulation
    theirs.set_state(simulation.field("qpos")[0].numpy(), simulation.field("qvel")[0].numpy())
    action = torch.full(ours.action_spec.shape, 0.5)
    reward = ours.step(data.set("action", action))["next", "reward"].item()
    if name == "reacher":
        theirs.data.qpos[2:] = data["task", "goal"][0].numpy()
        mujoco.mj_kinematics(theirs.model, theirs.data)
        expected = theirs._get_rew(action[0].numpy())[0]
    else:
        target = data["task", "velocity"].item()
        expected = -abs(theirs.data.qvel[0] - target) - theirs.control_cost(action[0].numpy())
    assert reward == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", IDS)
def test_it_takes_its_task_at_reset_and_does_not_show_it(example, name):
    task = example(name)
    env = task.make_changed_env(3, 0)
    check_env_specs(env)
    key = env.task.task_key
    _, high = env.task.parameter_bounds[key]
    seen = []
    for share in (0.5, -0.5):
        env.set_seed(0)
        given = TensorDict({"task": {key: (share * high).expand(3, -1)}}, [3])
        data = env.reset(given)
        assert torch.equal(data["task", key], given["task", key])
        seen.append(data["observation"])
    assert torch.equal(*seen)


def test_the_change_is_what_it_says_and_nothing_else(example):
    reacher, cheetah = example("reacher").Reacher, example("half_cheetah").HalfCheetah
    arm, changed = reacher().model, reacher(changed=True).model
    assert changed.body("fingertip").pos[0] == pytest.approx(1.5 * arm.body("fingertip").pos[0])
    assert changed.geom("link1").size[1] == pytest.approx(1.5 * arm.geom("link1").size[1])
    assert changed.actuator_gear[:, 0].tolist() == [200, -200]
    body, weak = cheetah().model, cheetah(changed=True).model
    ratio = weak.actuator_gear[:, 0] / body.actuator_gear[:, 0]
    np.testing.assert_allclose(ratio, [0.2, 1, 1, 1, 1, 1])
    np.testing.assert_array_equal(weak.body_inertia, body.body_inertia)


@pytest.mark.parametrize("changed", [False, True])
def test_the_controller_reaches_and_one_of_the_other_arm_does_not(example, changed):
    reacher = example("reacher")
    env = (reacher.make_changed_env if changed else reacher.make_env)(50, 0)
    for knows, bound in ((changed, 0.002), (not changed, None)):
        last = env.rollout(50, reacher.controller(knows))[:, -1]
        goal = last["task", "goal"]
        off = (last["next", "observation"][:, 6:] - goal).norm(dim=-1).median()
        assert off < bound if bound is not None else off > 0.05


def test_the_stored_gap_and_terms_are_those_of_the_stored_returns():
    files = [
        f
        for name in (*IDS, *VARIANTS)
        for f in (ROOT / "results/own_tasks" / name).glob("seed*.json")
    ]
    assert files
    for file in files:
        result = json.loads(file.read_text("utf-8"))
        means = result["means"]
        for kind, each in result["per_target"].items():
            assert means[kind] == pytest.approx(np.mean(each))
            terms = sum(term[kind] for term in result["terms"].values())
            assert terms == pytest.approx(means[kind], rel=1e-4)
        gap = means["rl_with_true_reward"] - means["carried_over"]
        closed = (means["adapted"] - means["carried_over"]) / gap
        assert result["gap_closed"] == pytest.approx(closed)
