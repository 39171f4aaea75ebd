"""Controllers by hand do what they are the yardsticks for."""

import pytest
import torch
from tensordict import TensorDict

import pemirl_envs


def final_state(name, controller):
    """Distances [30] of the mug to its test goal after an episode, and the cosines of its tilt."""
    env = pemirl_envs.make(name, 30, seed=0)
    goal = pemirl_envs.task_parameters(name, "test")["goal"]
    data = env.reset(task=TensorDict({"goal": goal}, [30]))
    upright = torch.ones(30, dtype=torch.float64)
    for _ in range(env.task.horizon):
        action = controller(data["observation"], {"goal": goal})
        data = env.step(data.set("action", action))["next"].exclude("reward")
        x, y = env.episodes.simulation.field("qpos")[:, 11:13].unbind(-1)
        upright = torch.minimum(upright, 1 - 2 * (x * x + y * y))
    mug = data["observation"][:, env.task.component_slice("mug_xy")]
    return (mug - goal).norm(dim=-1), upright


@pytest.fixture
def straight():
    return pemirl_envs.get_task("sawyer_pusher/normal").scripted_controller()


def test_the_pusher_reaches_every_goal_and_the_mug_stays_upright(straight):
    distance, upright = final_state("sawyer_pusher/normal", straight)
    assert distance.max() < 0.03
    assert upright.min() > 0.98


@pytest.mark.parametrize(
    ("name", "share"), [("sawyer_pusher/shift", 1.0), ("sawyer_pusher/shift_mirrored", 0.9)]
)
def test_the_wall_stops_who_pushes_directly_and_can_be_passed(straight, name, share):
    directly, _ = final_state(name, straight)
    around, upright = final_state(name, pemirl_envs.get_task(name).scripted_controller())
    assert (directly > 0.05).float().mean() >= 0.4
    assert (around < 0.03).float().mean() >= share
    assert upright.min() > 0.9


def test_the_way_around_a_wall_is_the_published_one():
    """The mug goes to (-0.16, 0.665) and then to (-0.16, 0.78): scores were measured with these."""
    task = pemirl_envs.get_task("sawyer_pusher/shift")
    goal = torch.tensor([[0.2, 0.9]])
    for mug, target in (((0.1, 0.6), (-0.16, 0.665)), ((-0.14, 0.665), (-0.16, 0.78))):
        observation = torch.tensor([[0.0, 0.4, 0.035, *mug, 0.05, 0.0, 0.0, 0.0]])
        there = {"goal": torch.tensor([target])}
        straight = pemirl_envs.get_task("sawyer_pusher/normal").scripted_controller()
        action = task.scripted_controller()(observation, {"goal": goal})
        assert torch.equal(action, straight(observation, there))


def test_the_mirrored_controller_is_the_mirror_image():
    shift, mirrored = (
        pemirl_envs.get_task(f"sawyer_pusher/{name}").scripted_controller()
        for name in ("shift", "shift_mirrored")
    )
    sign = torch.tensor([-1.0, 1.0, 1.0])
    observation = torch.randn(50, 9, generator=torch.Generator().manual_seed(0))
    goal = torch.randn(50, 2, generator=torch.Generator().manual_seed(1))
    seen_there = observation * sign.repeat(3), {"goal": goal * sign[:2]}
    assert torch.equal(mirrored(*seen_there), sign * shift(observation, {"goal": goal}))
