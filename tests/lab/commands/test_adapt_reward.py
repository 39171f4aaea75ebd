"""Adaptation: where it starts, what it reads, what it leaves."""

import shutil

import pytest
import torch

from pemirl_lab.commands import adapt_reward
from pemirl_trl import DemonstrationDataset, load_policy
from pemirl_trl.files import read_metadata
from pemirl_trl.methods import initial_policy
from pemirl_trl.pretrained import load_model

from ..conftest import ROOT

TINY = (
    "model_file=model.safetensors", "test_demonstrations=unseen.safetensors", "run_dir=adapted",
    "adaptation.optimization.iterations=1", "adaptation.rollouts=4", "threads=1", "logger=null",
)  # fmt: skip


@pytest.fixture(scope="module")
def unseen():
    return DemonstrationDataset.load(ROOT / "data/point_maze_test.safetensors")[:2]


@pytest.fixture
def trained(smoke, unseen, here):
    """A model and two demonstrations, in an empty folder."""
    shutil.copy(smoke[0] / "smoke/model.safetensors", here)
    unseen.save("unseen.safetensors")
    return here


def test_a_policy_is_left_with_what_it_takes_to_load_it(settings, trained):
    policy = adapt_reward.run(*settings("adapt_reward", *TINY))
    facts = read_metadata("adapted/policy.safetensors")
    expected = {"environment": "point_maze/right", "env_steps": "400", "activation": "tanh"}
    assert facts.items() >= expected.items()
    loaded = load_policy("adapted/policy.safetensors", load_model("model.safetensors"))
    for name, value in policy.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value), name


def test_a_demonstration_without_its_task_is_enough(settings, trained, unseen):
    """The user has one: what it is about is to be inferred."""
    DemonstrationDataset(unseen.observation, unseen.action).save("unseen.safetensors")
    given, own = settings("adapt_reward", *TINY, "adaptation.initial_policy=trained")
    policy = adapt_reward.run(given, own)
    start, _ = initial_policy(load_model("model.safetensors"), given.adaptation)
    change = [
        float((value - start.state_dict()[name]).abs().max())
        for name, value in policy.state_dict().items()
        if name.endswith("weight")
    ]
    assert min(change) > 0
    assert (trained / "adapted/policy.safetensors").exists()


def test_a_trained_policy_may_be_the_start(settings, trained):
    adapt_reward.run(*settings("adapt_reward", *TINY, "adaptation.initial_policy=trained"))
    assert read_metadata("adapted/policy.safetensors")["activation"] == "relu"


@pytest.mark.parametrize(
    ("file", "role"),
    [("model.safetensors", "model"), ("unseen.safetensors", "test demonstrations")],
)
def test_inputs_that_changed_are_refused(settings, trained, file, role):
    given = settings("adapt_reward", *TINY)
    adapt_reward.run(*given)
    with open(file, "ab") as changed:
        changed.write(b"\n")
    with pytest.raises(ValueError, match=f"{file} is not the {role} that the run in adapted began"):
        adapt_reward.run(*given)


def test_a_model_that_is_not_there_says_who_writes_it(settings, here):
    message = r"no file .*runs/meta_train/ant/.*/model.safetensors: pemirl meta_train writes it"
    with pytest.raises(FileNotFoundError, match=message):
        adapt_reward.run(*settings("adapt_reward", "experiment=ant", "logger=null"))
