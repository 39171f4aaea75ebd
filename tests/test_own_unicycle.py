"""A task whose starts differ more than its goals: examples/own_unicycle."""

import importlib
import json
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "results/own_tasks/unicycle").glob("seed*.json"))
WHOLE = sorted((ROOT / "results/own_tasks/unicycle_whole").glob("seed*.json"))


@pytest.fixture
def task(monkeypatch):
    """The example's module, from a clone."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "own_unicycle"))
    return importlib.import_module("unicycle")


def ends(task, env, motors):
    """How far from the target its controller ends, ``[N]``."""
    data = env.reset()
    for _ in range(task.T):
        action = task.controller(data["observation"], data["task", "target"], motors)
        data = env.step(data.set("action", action))["next"].exclude("reward")
    return -task.true_reward(data["observation"], data["task", "target"])


def test_the_controller_gets_there_from_any_heading_and_reversed_motors_defeat_it(task):
    assert ends(task, task.make(200, 0), 1.0).max() < 0.2
    assert ends(task, task.make_reversed(200, 0), -1.0).max() < 0.2
    assert ends(task, task.make_reversed(200, 0), 1.0).median() > 1.0


def test_headings_and_places_are_drawn_all_round(task):
    observation = task.make(2000, 0).reset()
    direction = observation["observation"][:, 2:4]
    assert direction.mean(0).norm() < 0.1
    distance = observation["task", "target"].norm(dim=-1)
    assert float((distance < task.REACH / 2**0.5).float().mean()) == pytest.approx(0.5, abs=0.05)


def test_it_goes_where_it_is_heading(task):
    env = task.make(4, 0)
    data = env.reset()
    before = data["observation"]
    push = torch.tensor([1.0, 0.0]).expand(4, 2)
    for _ in range(5):
        data = env.step(data.set("action", push))["next"].exclude("reward")
    way = data["observation"][:, :2] - before[:, :2]
    torch.testing.assert_close(way / way.norm(dim=-1, keepdim=True), before[:, 2:4])


def test_the_stored_gaps_are_those_of_their_means():
    for file in [*RESULTS, *WHOLE]:
        result = json.loads(file.read_text("utf-8"))
        means = result["means"]
        gap = means["rl_with_true_reward"] - means["carried_over"]
        found = (means["adapted"] - means["carried_over"]) / gap
        assert result["gap_closed"] == pytest.approx(found)
