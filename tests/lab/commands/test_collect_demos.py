"""Demonstrations, as the data card's commands make them."""

import torch

from pemirl_lab.commands import collect_demos, train_expert
from pemirl_trl import DemonstrationDataset

from ..conftest import ROOT
from .test_train_expert import TINY


def test_so_many_of_each_task_stand_in_a_row(settings, here):
    train_expert.run(*settings("train_expert", *TINY, "output=expert.safetensors"))
    made = collect_demos.run(
        *settings(
            "collect_demos",
            "expert=expert.safetensors",
            "output=demos.safetensors",
            "split=train",
            "per_task=2",
        )
    )
    assert len(made) == 26
    goals = made.tasks()["goal"].view(13, 2, 2)
    assert (goals[:, 0] == goals[:, 1]).all()
    again = DemonstrationDataset.load(here / "demos.safetensors")
    assert (again.observation == made.observation).all()
    assert again.provenance.extra["split"] == "train"
    assert again.provenance.command == (
        "pemirl collect_demos environment=point_maze/left split=train per_task=2 seed=0"
    )


def test_the_command_on_the_card_makes_the_published_demonstrations(command, here):
    command("collect_demos", ["split=test", "per_task=1", "seed=1", "output=again.safetensors"])
    made = DemonstrationDataset.load("again.safetensors")
    published = DemonstrationDataset.load(ROOT / "data/point_maze_test.safetensors")
    # Bit for bit on one machine; another's matrix products may round otherwise.
    torch.testing.assert_close(made.observation, published.observation, atol=1e-3, rtol=0)
    torch.testing.assert_close(made.action, published.action, atol=1e-3, rtol=1e-3)
