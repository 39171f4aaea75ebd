"""A tiny expert, and where it goes."""

import pytest

from pemirl_lab.commands import train_expert
from pemirl_lab.measuring.experts import load_expert
from pemirl_trl.files import read_metadata

TINY = (
    "expert_training.optimization.iterations=1", "expert_training.tasks_per_batch=2",
    "expert_training.rollouts_per_task=2", "evaluation.episodes=1", "logger=null", "threads=1",
)  # fmt: skip


def test_an_expert_is_left_with_its_facts(settings, here):
    reached = train_expert.run(*settings("train_expert", *TINY, "output=mine.safetensors"))
    facts = read_metadata("mine.safetensors")
    expected = {"environment": "point_maze/left", "env_steps": "400", "hidden": "64,64"}
    assert facts.items() >= (expected | {"test_return": f"{reached:.4f}"}).items()
    assert load_expert("mine.safetensors").in_keys == ["observation", ("task", "goal")]


def test_without_an_output_it_goes_where_the_task_looks(settings, here):
    where = ("experts.right=there/right.safetensors", "environment=point_maze/right")
    train_expert.run(*settings("train_expert", *TINY, *where))
    assert read_metadata("there/right.safetensors")["environment"] == "point_maze/right"


def test_dynamics_without_a_place_for_the_expert_are_refused_before_training(settings, here):
    given = settings("train_expert", *TINY, "task=ant", "environment=ant/normal_rk4")
    with pytest.raises(ValueError, match="task=ant names no expert of ant/normal_rk4"):
        train_expert.run(*given)
