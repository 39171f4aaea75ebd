"""What is exported says where it is from; the models of the zoo do, and are what they say."""

import ast
import json
import re
import shutil
from pathlib import Path

import pytest
import torch
import yaml

import pemirl_envs
from pemirl_lab import cli
from pemirl_lab.runs.places import data_file
from pemirl_trl import (
    DemonstrationDataset,
    PortableReward,
    infer,
    load_card,
    load_model,
    load_reward,
)
from pemirl_trl.methods.own_training import digest
from pemirl_trl.pretrained import zoo

from ..conftest import ROOT

FACTS = ("licence=MIT", "command=make it")


def run(monkeypatch, *words):
    monkeypatch.setattr("sys.argv", ["pemirl", *words])
    cli.main()


@pytest.fixture
def trained(smoke, here):
    """The run of a quickstart, copied to where this test may change it."""
    shutil.copytree(smoke[0] / "smoke", here / "run")
    return here / "run" / "model.safetensors"


def test_a_reward_takes_its_card_from_its_run(trained, monkeypatch, capsys):
    run(monkeypatch, "export_reward", f"model_file={trained}", "reward_file=r.safetensors", *FACTS)
    card, reward = load_card("r.safetensors"), load_reward("r.safetensors")
    assert card.domain == "point_maze/left"
    assert card.settings["method"] == "pemirl_robust"
    assert card.settings["training"]["iterations"] == load_yaml(trained)["training"]["iterations"]
    train = DemonstrationDataset.load(ROOT / "data/point_maze_train.safetensors")
    assert card.data_sha256 == digest(train)
    assert {"one_shot/left/all/return", "reward_adaptation/right/all/normalised"} <= set(
        card.measures
    )
    assert (card.licence, card.command) == ("MIT", "make it")
    assert Path("r.md").read_text() == card.markdown("r")
    s, m = torch.rand(5, 2), torch.zeros(reward.config.context_dim)
    assert torch.equal(reward(s, m), load_model(trained).reward.reward(s, m).detach())
    assert "card -> r.md" in capsys.readouterr().out


def load_yaml(model):
    return yaml.safe_load((model.parent / "config.yaml").read_text())


def test_a_folder_and_a_model(trained, monkeypatch):
    run(monkeypatch, "export_reward", f"model_file={trained}", "folder=shared")
    run(monkeypatch, "export_model", f"model_file={trained}", "to=m.safetensors", *FACTS)
    folder = PortableReward.from_pretrained("shared")
    assert folder.card.licence == "unknown"
    assert load_card("m.safetensors").domain == folder.card.domain
    m = load_model("m.safetensors")
    for name, value in load_model(trained).state_dict().items():
        assert torch.equal(m.state_dict()[name], value)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), r"export_reward: missing model_file"),
        (("model_file=no.safetensors", "reward_file=r"), "pemirl meta_train writes it"),
        (("model_file=MODEL",), "expected one of reward_file=FILE and folder=NAME"),
        (("model_file=MODEL", "reward_file=r", "folder=f"), "expected one of"),
        (("model_file=MODEL", "reward_file=r", "colour=1"), "colour"),
        (
            (
                "model_file=MODEL",
                "reward_file=r",
                "demonstrations=data/point_maze_test.safetensors",
            ),
            "is not what the run in .* was trained on",
        ),
        (("model_file=ALONE", "reward_file=r"), "no file .*config.yaml: the card"),
    ],
)
def test_what_cannot_be_exported_is_said(trained, monkeypatch, words, message):
    (trained.parents[1] / "alone").mkdir()
    shutil.copy(trained, "alone/model.safetensors")
    places = {"MODEL": str(trained), "ALONE": "alone/model.safetensors"}
    given = [re.sub("MODEL|ALONE", lambda found: places[found[0]], word) for word in words]
    with pytest.raises(SystemExit, match=message):
        run(monkeypatch, "export_reward", *given)
    assert not Path("r").exists()


@pytest.mark.parametrize("command", ["export_reward", "export_model"])
def test_help(monkeypatch, capsys, command):
    run(monkeypatch, command, "--help")
    assert f"pemirl {command} model_file=" in capsys.readouterr().out


def test_infer_takes_a_reward_and_a_name(trained, monkeypatch, capsys):
    one = (f"demonstration={data_file('data/point_maze_test.safetensors')}", "index=2")
    run(monkeypatch, "export_reward", f"model_file={trained}", "reward_file=r.safetensors")
    printed = []
    for file in (trained, "r.safetensors", "point_maze"):
        capsys.readouterr()
        run(monkeypatch, "infer", f"model_file={file}", *one)
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1] != printed[2]
    assert "within the training family" in printed[2]


# --- the zoo -----------------------------------------------------------------------------------

DOMAINS = [name for name in zoo() if (ROOT / f"data/{name}_train.safetensors").exists()]
PROVED = sorted(set(zoo()) - set(DOMAINS))


def made_by_nox():
    """The names that ``nox -s zoo`` knows."""
    tree = ast.parse((ROOT / "noxfile.py").read_text("utf-8"))
    values = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    return {*ast.literal_eval(values["ZOO"]), *ast.literal_eval(values["PROVED"])}


def test_the_zoo_is_what_the_repository_has():
    assert zoo() == sorted(file.stem for file in (ROOT / "zoo").glob("*.safetensors"))
    assert {"point_maze", "pendulum"} <= set(zoo())


@pytest.mark.parametrize("name", zoo())
def test_a_model_of_the_zoo_has_its_card(name):
    card = load_card(name)
    assert card.licence == "MIT"
    assert card.command == f"nox -s zoo -- {name}"
    assert card.measures
    assert (ROOT / f"zoo/{name}.md").read_text("utf-8") == card.markdown(name)
    assert load_model(name).family is not None
    assert name in made_by_nox()


@pytest.mark.parametrize("name", PROVED)
def test_a_model_of_a_proof_says_what_its_result_says(name):
    card = load_card(name)
    stored = json.loads((ROOT / "results" / card.domain / "seed0.json").read_text("utf-8"))
    assert card.measures == {**stored["means"], "gap_closed": stored["gap_closed"]}
    assert card.versions["commit"] == stored["commit"]


@pytest.mark.parametrize("name", DOMAINS)
def test_a_model_of_the_zoo_is_of_the_committed_demonstrations(name):
    card, reward = load_card(name), load_reward(name)
    train = DemonstrationDataset.load(ROOT / f"data/{name}_train.safetensors")
    assert card.data_sha256 == digest(train)
    assert card.domain in pemirl_envs.TASKS
    test = DemonstrationDataset.load(ROOT / f"data/{name}_test.safetensors")
    inferred = [infer(reward, test[i]) for i in range(0, len(test), 10)]
    assert sum(not i.distance.far for i in inferred) >= 0.8 * len(inferred)


def test_the_model_in_the_wheel_is_small():
    assert (ROOT / "zoo/point_maze.safetensors").stat().st_size < 1_000_000


def test_its_reward_points_at_the_goals_of_unseen_tasks():
    """The best of a grid of states is within 5 cm of each goal, from one demonstration."""
    reward = load_reward("point_maze")
    test = DemonstrationDataset.load(ROOT / "data/point_maze_test.safetensors")
    axis = torch.linspace(0.0, 0.6, 61)
    grid = torch.cartesian_prod(axis, axis)
    off = []
    for i in range(len(test)):
        best = grid[reward(grid, infer(reward, test[i]).context).argmax()]
        off.append(float((best - test.tasks()["goal"][i]).norm()))
    assert max(off) < 0.05
