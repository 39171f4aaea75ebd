"""What is typed, and what does not go together."""

import dataclasses
import json

import pytest
import torch
from tensordict import TensorDict

from pemirl_lab.runs.settings import Subset
from pemirl_trl.methods import METHODS, AIRLConfig, PEMIRLConfig


def values_of(config):
    """Of YAML: without the difference of lists and tuples."""
    return type(config), json.loads(json.dumps(dataclasses.asdict(config)))


def test_a_method_arrives_as_the_library_has_it(settings):
    for name, method in METHODS.items():
        given, _ = settings("meta_train", f"method={name}")
        assert given.method == name
        assert values_of(given.learning) == values_of(method)
    given, _ = settings("meta_train", "method=airl", "training.reward_steps=3")
    assert given.learning.training == AIRLConfig(
        policy=METHODS["airl"].training.policy, reward_steps=3
    )


def test_a_commands_own_values_are_apart(settings):
    given, own = settings("evaluate", "experiment=ant", "meta_run=there")
    assert own.meta_run == "there"
    assert given.resolved["meta_run"] == "there"
    assert isinstance(given.learning.training, PEMIRLConfig)
    assert given.subsets["forward"] == Subset(parameter="direction", index=0, low=1.0, high=1.0)


def test_facts_of_the_task_come_from_the_task(settings):
    maze, _ = settings("meta_train")
    ant, _ = settings("meta_train", "task=ant")
    assert (maze.planar, maze.task_key) == (True, "goal")
    assert (ant.planar, ant.task_key) == (False, "direction")


@pytest.mark.parametrize("method", ["airl", "meta_infogail", "pemirl"])
def test_an_experiment_with_another_method_is_refused(settings, method):
    with pytest.raises(ValueError, match=rf"experiment=ant is task=ant with method=pemirl_contras"
                       rf"tive; got task=ant with method={method}: choose another"):  # fmt: skip
        settings("meta_train", "experiment=ant", f"method={method}")


def test_an_experiment_with_another_task_is_refused_and_may_be_left_out(settings):
    with pytest.raises(ValueError, match=r"got task=sweeper with method=pemirl_robust: .*freely"):
        settings("quickstart", "task=sweeper")
    given, _ = settings("quickstart", "task=sweeper", "~experiment")
    assert (given.task, given.method, given.experiment) == ("sweeper", "pemirl", None)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["info_estimator=public_code", "method=airl"],
            "^info_estimator=public_code is for method=pemirl and its extensions; got method=airl",
        ),
        (
            ["method=airl", "initial_policy=meta_il"],
            "^initial_policy=meta_il needs contexts; got context_dim=0",
        ),
        (["test_environment=ant/no"], "^test_environment=ant/no: unknown task 'ant/no'; expected"),
        (
            ["task=ant", "subsets.forward.index=-1"],
            r"^subsets\.forward\.index=-1: expected greater",
        ),
        (["expert_training.policy.scale=0"], "^expert_training.policy.scale=0: expected greater"),
    ],
)
def test_what_does_not_go_together_is_refused(settings, overrides, message):
    with pytest.raises(ValueError, match=message):
        settings("meta_train", *overrides)


def test_an_expert_that_the_task_does_not_name_is_refused(settings):
    given, _ = settings("meta_train", "task=ant")
    assert given.expert_file("ant/disabled") == "data/ant_disabled_expert.safetensors"
    message = (
        r"task=ant names no expert of ant/normal_rk4; .*'disabled_left', 'normal'\]: add \+exp"
    )
    with pytest.raises(ValueError, match=message):
        given.expert_file("ant/normal_rk4")
    added, _ = settings("meta_train", "task=ant", "+experts.normal_rk4=mine.safetensors")
    assert added.expert_file("ant/normal_rk4") == "mine.safetensors"


def test_a_subset_is_a_closed_range():
    tasks = TensorDict(
        {"goal": torch.tensor([[0.0, 9.0], [0.1, 9.0], [0.4, 9.0], [0.5, 9.0]])}, [4]
    )
    mask = Subset(parameter="goal", index=0, low=0.1, high=0.4).mask(tasks)
    assert mask.tolist() == [False, True, True, False]
