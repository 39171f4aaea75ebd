"""The promise on a task whose episodes differ in length: examples/own_puck."""

import importlib
import json
from pathlib import Path

import pytest
import torch
from torchrl.envs import Compose, StepCounter, TransformedEnv

from pemirl_trl import AbsorbingState

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "results/own_tasks/puck").glob("seed*.json"))

pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning")


@pytest.fixture
def example(monkeypatch):
    """Imports a module of the example, from a clone."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "own_puck"))
    return importlib.import_module


def test_demonstrations_differ_in_length_and_end_near_the_gate(example):
    task = example("puck")
    demos = task.demonstrations(100, 0)
    assert demos.horizon == task.T
    assert len(demos.lengths.unique()) > 5
    last = demos.observation[:, -1]  # padding repeats where the puck left the table
    assert torch.equal(task.has_left(last).squeeze(-1), demos.ended)
    assert demos.ended.float().mean() > 0.95
    assert (last[:, :2] - demos.tasks()["gate"]).norm(dim=-1).median() < 0.2


def test_reversed_pushes_defeat_the_controller_and_an_exit_costs_the_rest(example):
    task = example("puck")
    returns = {}
    for push in (1.0, -1.0):
        env = TransformedEnv(task.Puck(50, 0, push), Compose(AbsorbingState(), StepCounter(task.T)))

        def act(td):
            return td.set("action", task.controller(td["observation"], td["task", "gate"]))

        rollouts = env.rollout(task.T, act, break_when_any_done=False)
        returns[push] = rollouts["next", "reward"].sum(1).mean()
    assert returns[1.0] > -25
    assert returns[-1.0] < -80  # T times almost the diameter
    place = torch.tensor([[0.6, 0.8, 0.0, 0.0]])
    assert task.true_reward(place, torch.tensor([[0.6, 0.0]])) == pytest.approx(-0.8)


def test_the_stored_results_close_most_of_the_gap_and_say_what_is_left():
    """Nine tenths are the aim, and missed by a hundredth: docs/proofs.md says why."""
    results = [json.loads(file.read_text("utf-8")) for file in RESULTS]
    assert results
    for result in results:
        assert result["task"] == "own_tasks/puck"
        means = result["means"]
        gap = means["rl_with_true_reward"] - means["carried_over"]
        assert result["gap_closed"] == pytest.approx(
            (means["adapted"] - means["carried_over"]) / gap
        )
        assert result["gap_closed"] >= 0.85
        learned = {name: sum(each["learned_returns"]) for name, each in result["scores"].items()}
        assert learned["adapted"] > learned["expert"]  # what is left is the reward's fault
        assert len(set(result["demonstrated_lengths"])) > 5


@pytest.mark.long
def test_a_policy_for_reversed_pushes_closes_most_of_the_gap(example):
    """A seed that no setting was chosen on."""
    assert example("run_puck").run(7, {}, {}).result["gap_closed"] >= 0.8
