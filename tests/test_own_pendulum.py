"""The promise on a task that the library's settings were never tuned for: examples/own_pendulum."""

import importlib
import json
from pathlib import Path

import pytest
import torch

from pemirl_lab.measuring.state_proofs import prove

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "results/own_tasks/pendulum").glob("seed*.json"))

pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning")


@pytest.fixture
def example(monkeypatch):
    """Imports a module of the example, from a clone."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "own_pendulum"))
    return importlib.import_module


def test_the_controller_holds_the_pendulum_and_a_reversed_motor_defeats_it(example):
    task = example("pendulum")
    target = task.direction(torch.linspace(0.0, 6.0, 50).unsqueeze(-1))
    for motor, bound in ((1.0, 0.05), (-1.0, None)):
        env = task.Pendulum(50, 0, motor)
        data = env.reset().set("task", {"target": target})
        env.target = target
        for _ in range(task.T):
            action = task.controller(data["observation"], target)
            data = env.step(data.set("action", action))["next"].exclude("reward")
        off = task.offset(data["observation"], target).abs().mean()
        assert off < bound if bound is not None else off > 0.5


def test_what_holds_the_pendulum_shakes_a_light_one(example):
    task = example("pendulum")
    speeds = {}
    for knows in (task.LIGHT, task.MASS):
        env = task.make_light(50, 0)
        data = env.reset()
        for _ in range(task.T):
            action = task.controller(data["observation"], data["task", "target"], mass=knows)
            data = env.step(data.set("action", action))["next"].exclude("reward")
        speeds[knows] = data["observation"][:, 2].abs().median()
    assert speeds[task.LIGHT] < 0.05
    assert speeds[task.MASS] > 1.0


def test_the_offset_is_the_angle_to_the_target(example):
    task = example("pendulum")
    angle, target = torch.tensor([[3.0], [0.5]]), torch.tensor([[-3.0], [0.2]])
    observation = torch.cat([task.direction(angle), torch.zeros(2, 1)], -1)
    expected = torch.tensor([[2 * torch.pi - 6.0], [-0.3]])
    torch.testing.assert_close(task.offset(observation, task.direction(target)), expected)


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


@pytest.mark.long
def test_a_policy_for_the_reversed_motor_closes_nine_tenths_of_the_gap(example):
    """A seed that no setting was chosen on."""
    (proved,) = prove([example("run").REVERSED], 3)
    assert proved.result["gap_closed"] >= 0.9
