"""examples/several_bodies: bodies, their demonstrators, and a whole run at smoke size."""

import importlib
import json
from pathlib import Path

import pytest
import torch

from pemirl_trl.methods.stages import stages

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "results/transfer").glob("several_bodies_*/*.json"))


@pytest.fixture
def example(monkeypatch):
    """Imports a module of the example, from a clone."""
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "several_bodies"))
    return importlib.import_module


@pytest.fixture
def experiment(example):
    """Two bodies of the pusher, whose tasks are the validation goals."""
    families, transfer = example("families"), example("transfer")
    family = families.SAWYER.__class__(
        **{**vars(families.SAWYER), "demonstrations": 2, "split": "validation"}
    )
    return transfer.Experiment(family, "whole", 2, 0, "preset=smoke")


def test_each_body_is_demonstrated_by_its_own(experiment):
    data = experiment.demonstrate("validation", 2, 1, seed=0)
    body = data.tasks()["body"].argmax(-1)
    assert body.bincount().tolist() == [15, 15]
    assert torch.equal(data.observation[:, 0, -2:], data.tasks()["body"])
    distance = (data.observation[:, -1, 3:5] - data.tasks()["goal"]).norm(dim=-1)
    assert (distance < 0.05).float().mean() > 0.9
    # Round the wall's end at x = 0.15 m, or straight on.
    widest = data.observation[..., 3].amax(1)
    assert (widest[body == 1] > 0.15).all()
    assert widest[body == 0].median() < 0.15


def test_a_whole_run(experiment):
    result = experiment.run(stages(None, None, "a test"))
    assert result["returns"].keys() == {"adapted", "carried_over", "known", "random"}
    assert len(result["read"]) == 9
    assert "body" not in "".join(result["read"])
    assert result["contexts"].keys() == {"task", "body"}
    assert result["returns"]["known"]["true"] > result["returns"]["random"]["true"] + 40


def test_the_new_body_is_none_of_the_demonstrators(example):
    """Its dynamics are those of ``changed``, which no body has."""
    families = example("families")
    for family in families.FAMILIES.values():
        changed = families.get_task(family.changed).model
        for body in family.bodies:
            same = [
                getattr(body.task.model, name).shape == getattr(changed, name).shape
                and (getattr(body.task.model, name) == getattr(changed, name)).all()
                for name in ("geom_pos", "geom_size", "actuator_gear", "dof_damping")
            ]
            assert not all(same)


@pytest.mark.parametrize("file", RESULTS, ids=lambda file: f"{file.parent.name}/{file.stem}")
def test_published_results_say_what_they_say(file):
    result = json.loads(file.read_text("utf-8"))
    assert file.stem == f"{result['reads']}_bodies{result['bodies']}_seed{result['seed']}"
    true = {name: value["true"] for name, value in result["returns"].items()}
    gap = (true["adapted"] - true["carried_over"]) / (true["known"] - true["carried_over"])
    assert result["gap_closed"] == pytest.approx(gap)
    assert "dirty" not in result["commit"]
