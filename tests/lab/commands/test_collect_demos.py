"""Demonstrations, as the data card's commands make them."""

import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_envs import make
from pemirl_lab.commands import collect_demos, train_expert
from pemirl_lab.commands.collect_demos import by_turns
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
        "pemirl collect_demos environment=point_maze/left split=train per_task=2 seed=0 "
        "expert=[expert.safetensors]"
    )


def test_the_command_on_the_card_makes_the_published_demonstrations(command, here):
    command("collect_demos", ["split=test", "per_task=1", "seed=1", "output=again.safetensors"])
    made = DemonstrationDataset.load("again.safetensors")
    published = DemonstrationDataset.load(ROOT / "data/point_maze_test.safetensors")
    # Bit for bit on one machine; another's matrix products may round otherwise.
    torch.testing.assert_close(made.observation, published.observation, atol=1e-3, rtol=0)
    torch.testing.assert_close(made.action, published.action, atol=1e-3, rtol=1e-3)


def test_several_experts_demonstrate_by_turns(settings, here):
    """Each episode is, without noise, the one that its expert alone would have made."""
    names = [f"{ROOT}/data/point_maze_{side}_expert.safetensors" for side in ("left", "right")]

    def actions(expert):
        return by_turns(expert)(start.clone())["action"]

    env = make("point_maze/left", 6, seed=0)
    start = env.reset()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        left, right, both = actions(names[:1]), actions(names[1:]), actions(names)
    assert not torch.equal(left, right)
    assert torch.equal(both[0::2], left[0::2])
    assert torch.equal(both[1::2], right[1::2])
    given = settings(
        "collect_demos",
        "split=test",
        "per_task=1",
        f"expert=[{','.join(names)}]",
        "output=mixed.safetensors",
    )
    assert collect_demos.run(*given).provenance.command.endswith(f"expert=[{','.join(names)}]")
