"""What experts reach, and what a person would look at in their episodes."""

import pytest
import torch
from tensordict import TensorDict

import pemirl_envs
from pemirl_trl.evaluation import read

from .conftest import config


def test_experts_and_the_one_that_is_carried_over(recipe, tmp_path):
    values = config(
        "measure_experts", "task=point_maze", f"results={tmp_path}", "evaluation.episodes=1"
    )
    recipe("measure_experts").measure_experts(values)
    own, carried = (
        read(tmp_path / row / "seed0.json") for row in ("expert", "expert_carried_over")
    )
    assert {(s.setting, s.variant) for s in own.scores} == {("expert", "left"), ("expert", "right")}
    assert [s.normalised for s in own.scores] == pytest.approx([1.0, 1.0])
    (lost,) = carried.scores
    assert (lost.setting, lost.variant) == ("policy_generalisation", "right")
    assert lost.normalised < 0.6  # it stands before the barrier
    assert own.reward["final_distance_m/right"] < 0.02 < carried.reward["final_distance_m/right"]


@pytest.mark.parametrize("task", ["point_maze", "sweeper", "sawyer_pusher"])
def test_the_final_distance_is_what_the_reward_asks_for(recipe, task):
    """Moving the goal to where the object ends makes it zero."""
    name, outcome = recipe("outcomes").OUTCOMES[task]
    variant = "left" if task == "point_maze" else "normal"
    env = pemirl_envs.make(f"{task}/{variant}", 3, seed=0)
    rollouts = env.rollout(20, break_when_any_done=False)
    observation = rollouts["next", "observation"]
    tasks = rollouts["task"][:, 0]
    object_ = {"point_maze": slice(0, 2), "sweeper": slice(17, 19), "sawyer_pusher": slice(3, 5)}
    end = observation[:, -1, object_[task]]
    assert name == "final_distance_m"
    torch.testing.assert_close(outcome(observation, tasks), (end - tasks["goal"]).norm(dim=-1))
    at_goal = TensorDict({"goal": end}, [3])
    assert torch.equal(outcome(observation, at_goal), torch.zeros(3))


def test_the_speed_is_the_way_over_the_time(recipe):
    env = pemirl_envs.make("ant/normal", 2, seed=0)
    data = env.reset(task=TensorDict({"direction": torch.tensor([[1.0], [-1.0]])}, [2]))
    start = env.episodes.simulation.field("qpos")[:, 0].clone()
    rollouts = env.rollout(40, auto_reset=False, tensordict=data, break_when_any_done=False)
    way = env.episodes.simulation.field("qpos")[:, 0] - start
    _, outcome = recipe("outcomes").OUTCOMES["ant"]
    speed = outcome(rollouts["next", "observation"], rollouts["task"][:, 0])
    expected = way / (40 * env.task.control_timestep) * torch.tensor([1.0, -1.0])
    torch.testing.assert_close(speed.double(), expected, atol=0.05, rtol=0.0)
