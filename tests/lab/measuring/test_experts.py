"""Experts are what their files say."""

import pytest
import torch
from safetensors.torch import load_file
from torch import nn

import pemirl_envs
from pemirl_lab.measuring.experts import expert_facts, load_expert, new_expert
from pemirl_lab.runs.places import data_file
from pemirl_trl.files import save_weights

from ..conftest import ROOT


@pytest.mark.parametrize("task", ["point_maze", "ant", "sweeper", "sawyer_pusher"])
def test_an_expert_loads_from_its_file_alone(settings, task, monkeypatch):
    """All that it is stands in the file, and nothing is simulated."""
    monkeypatch.setattr(pemirl_envs, "make", None)
    given, _ = settings("meta_train", f"task={task}")
    for path in given.experts.values():
        policy, stored = load_expert(path), load_file(data_file(path))
        held = policy.state_dict()
        assert len(stored) >= len(held) > 0
        for name, value in held.items():
            torch.testing.assert_close(value, stored[f"policy.{name}"], rtol=0, atol=0)


@pytest.mark.parametrize("name", ["point_maze/left", "sawyer_pusher/normal"])
def test_a_new_expert_comes_back_from_its_file(settings, here, name):
    """Its sizes, its activation and both maps of what it reads are the task's."""
    task = name.split("/")[0]
    given, _ = settings("train_expert", f"task={task}")
    sizes = given.expert_training.policy
    policy = new_expert(name, sizes)
    save_weights("expert.safetensors", {"policy": policy}, expert_facts(name, sizes))
    again = load_expert("expert.safetensors")
    tasks = pemirl_envs.task_parameters(name, "test")[:3]
    env = pemirl_envs.make(name, 3, seed=0)
    data = env.reset(task=tasks)
    assert torch.equal(policy.get_dist(data).mean, again.get_dist(data).mean)
    maps = {key for key in policy.state_dict() if "standardize_context" in key}
    assert bool(maps) == sizes.standardize_task


def test_a_file_of_something_else_is_refused_by_name(here):
    with pytest.raises(ValueError, match=r"point_maze_test\.safetensors holds 'demonstrations', f"):
        load_expert(f"{ROOT}/data/point_maze_test.safetensors")
    save_weights("other.safetensors", {"policy": nn.Linear(1, 1)}, {"hidden": "64"})
    message = r"other\.safetensors holds no expert: it does not say environment"
    with pytest.raises(ValueError, match=message):
        load_expert("other.safetensors")
    with pytest.raises(FileNotFoundError, match=r"no file none\.safetensors \(looked at"):
        load_expert("none.safetensors")
