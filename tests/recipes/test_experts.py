"""Experts, and the demonstrations that they give."""

import pytest
import torch
from safetensors.torch import load_file

from .conftest import RECIPES, config


def test_expert_and_demonstrations(recipe, tmp_path, monkeypatch):
    """A tiny expert and its demonstrations, as the data card's commands make them."""
    monkeypatch.chdir(tmp_path)
    tiny = ("optimization.iterations=1", "tasks_per_batch=2", "rollouts_per_task=2")
    values = config(
        "train_expert", *tiny, "output=expert.safetensors", "evaluation.episodes=1", "logger=null"
    )
    recipe("train_expert").train_expert(values, recipe("run_folder").RunFolder(values))
    values = config(
        "collect_demos", "expert=expert.safetensors", "output=demos.safetensors", "split=train",
        "per_task=2",
    )  # fmt: skip
    demonstrations = recipe("collect_demos").collect_demos(values)
    assert len(demonstrations) == 26
    goals = demonstrations.tasks()["goal"].view(13, 2, 2)
    assert (goals[:, 0] == goals[:, 1]).all()
    again = type(demonstrations).load(tmp_path / "demos.safetensors")
    assert (again.observation == demonstrations.observation).all()
    assert again.provenance.extra["split"] == "train"


def test_the_command_on_the_card_makes_the_published_demonstrations(recipe, tmp_path):
    output = tmp_path / "again.safetensors"
    values = config("collect_demos", "split=test", "per_task=1", "seed=1", f"output={output}")
    made = recipe("collect_demos").collect_demos(values)
    published = type(made).load(RECIPES.parent / "data/point_maze_test.safetensors")
    # Bit for bit on one machine; another's matrix products may round otherwise.
    torch.testing.assert_close(made.observation, published.observation, atol=1e-3, rtol=0)
    torch.testing.assert_close(made.action, published.action, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("task", ["point_maze", "ant", "sweeper", "sawyer_pusher"])
def test_an_expert_loads_from_its_file_alone(recipe, task, monkeypatch):
    """All that it is stands in the file, and nothing is simulated."""
    domains = recipe("domains")
    monkeypatch.setattr(domains.pemirl_envs, "make", None)
    for path in config("evaluate", f"task={task}").experts.values():
        policy, stored = domains.load_expert(path), load_file(domains.data_file(path))
        held = policy.state_dict()
        assert len(stored) >= len(held) > 0
        for name, value in held.items():
            torch.testing.assert_close(value, stored[f"policy.{name}"], rtol=0, atol=0)
