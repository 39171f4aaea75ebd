"""Controllers by hand do what they are the yardsticks for."""

import torch
from tensordict import TensorDict

import pemirl_envs

from .conftest import config


def final_state(name, policy):
    """Distances [30] of the mug to its test goal after an episode, and the cosines of its tilt."""
    env = pemirl_envs.make(name, 30, seed=0)
    goal = pemirl_envs.task_parameters(name, "test")["goal"]
    data = env.reset(task=TensorDict({"goal": goal}, [30]))
    upright = torch.ones(30, dtype=torch.float64)
    for _ in range(env.task.horizon):
        data = env.step(policy(data))["next"].exclude("reward")
        x, y = env.episodes.simulation.field("qpos")[:, 11:13].unbind(-1)
        upright = torch.minimum(upright, 1 - 2 * (x * x + y * y))
    return (data["observation"][:, 3:5] - goal).norm(dim=-1), upright


def test_the_pusher_reaches_every_goal_and_the_mug_stays_upright(recipe):
    distance, upright = final_state(
        "sawyer_pusher/normal", recipe("yardsticks").YARDSTICKS["sawyer_pusher/normal"]
    )
    assert distance.max() < 0.03
    assert upright.min() > 0.98


def test_the_wall_stops_who_pushes_directly_and_can_be_passed(recipe):
    yardsticks = recipe("yardsticks").YARDSTICKS
    directly, _ = final_state("sawyer_pusher/shift", yardsticks["sawyer_pusher/normal"])
    around, upright = final_state("sawyer_pusher/shift", yardsticks["sawyer_pusher/shift"])
    assert (directly > 0.05).float().mean() >= 0.4
    assert around.max() < 0.03
    assert upright.min() > 0.9


def test_scripts_are_measured_beside_the_experts(recipe, tmp_path):
    values = config(
        "measure_experts", "task=sawyer_pusher", f"results={tmp_path}", "evaluation.episodes=1"
    )
    results = recipe("measure_experts").measure_experts(values)
    found = {r.row: {(s.setting, s.variant): s.normalised for s in r.scores} for r in results}
    assert found["scripted"].keys() == found["expert"].keys()
    assert min(found["scripted"].values()) > 0.95
    (lost,) = found["scripted_carried_over"].values()
    assert lost < 0.9 < min(found["scripted"].values())
