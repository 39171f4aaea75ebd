"""Discrete actions on a task that no setting was tuned on: examples/own_grid."""

import importlib
import json
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "results/own_tasks/grid").glob("seed*.json"))


@pytest.fixture
def example(monkeypatch):
    """Imports a module of the example, from a clone."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "own_grid"))
    return importlib.import_module


def walked(task, keys, act_keys):
    """How far from its goal the controller ends, in cells."""
    env = task.Grid(50, 0, keys)
    data = env.reset()
    for _ in range(task.T):
        seen = torch.cat([data[key] for key in task.KEYS], -1)
        move = task.controller(seen, data["task", "goal"], act_keys)
        data = env.step(data.set("action", move))["next"].exclude("reward")
    return (env.cell - env.goal).norm(dim=-1)


def test_the_controller_reaches_the_goal_and_moves_turned_around_defeat_it(example):
    task = example("grid")
    assert (walked(task, 1, 1) == 0).all()
    assert (walked(task, -1, -1) == 0).all()
    assert walked(task, -1, 1).mean() > 5


def test_demonstrations_are_choices_that_lead_where_they_say(example):
    task = example("grid")
    data = task.demonstrations(20, 1)
    assert data.discrete
    cells = task.place(data.observation)
    moved = (cells[:, :-1] + task.MOVES[data.action.argmax(-1)]).clamp(0, task.SIZE - 1)
    torch.testing.assert_close(moved, cells[:, 1:])
    strays = (cells[:, -10:] - data.task["goal"].unsqueeze(1)).norm(dim=-1)
    assert strays.mean() < 1.0  # it stays at the goal, but for the noise


def test_the_true_reward_is_minus_the_distance_in_cells(example):
    task = example("grid")
    cell, goal = torch.tensor([[3.0, 4.0], [0.0, 10.0]]), torch.tensor([[0.0, 0.0], [0.0, 9.0]])
    reward = task.true_reward(task.observation(cell), goal)
    torch.testing.assert_close(reward, torch.tensor([[-5.0], [-1.0]]))


def test_the_stored_results_close_nine_tenths_of_the_gap():
    results = [json.loads(file.read_text("utf-8")) for file in RESULTS]
    assert len(results) >= 3
    for result in results:
        means = result["means"]
        gap = means["rl_with_true_reward"] - means["carried_over"]
        assert result["gap_closed"] == pytest.approx(
            (means["adapted"] - means["carried_over"]) / gap
        )
        assert result["gap_closed"] >= 0.9
        assert sum(result["seconds"].values()) < 15 * 60
        assert result["settings"] == {"meta_train": [], "adapt_reward": []}


@pytest.mark.long
def test_a_policy_for_moves_turned_around_closes_nine_tenths_of_the_gap(example, tmp_path):
    """A seed that no setting was chosen on."""
    assert example("run_grid").run(3, tmp_path).result["gap_closed"] > 0.9
