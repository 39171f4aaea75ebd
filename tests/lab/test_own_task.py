"""Commands on an environment of the user's own: ``env=my_module:make_env``."""

import dataclasses
import importlib
import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from pemirl_lab import cli
from pemirl_lab.runs.own_task import OwnTask, load_make_env, parse_words
from pemirl_trl import CategoricalPolicy, DemonstrationDataset, infer, load_model, load_policy

PENDULUM = Path(__file__).parents[2] / "examples" / "own_pendulum" / "pendulum.py"
FEW = (
    "meta_il.steps=4",
    "meta_il.steps_per_iteration=2",
    "contexts_per_batch=2",
    "training.iterations=2",
    "training.rollouts_per_context=2",
    "training.batch.trajectories=8",
    "logger=null",
)
STATES = "model.encoder_reads=states"
TRAIN = ("demonstrations=train.safetensors", "env=my_pendulum:make", "run_dir=R")
ADAPT = (
    "model_file=R/model.safetensors",
    "test_demonstrations=one.safetensors",
    "env=my_pendulum:make_reversed",
    "run_dir=A",
    "rollouts=4",
    "optimization.iterations=3",
    "logger=null",
)


@pytest.fixture
def mine(here, monkeypatch):
    """A working directory with a module of the user's and two files."""
    shutil.copy(PENDULUM, here / "my_pendulum.py")
    monkeypatch.syspath_prepend(str(here))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(here / "minari"))
    task = importlib.import_module("my_pendulum")
    task.demonstrations(6, 1).save(here / "train.safetensors")
    task.demonstrations(1, 2).save(here / "one.safetensors")
    yield here
    sys.modules.pop("my_pendulum", None)


@pytest.fixture
def pemirl(mine, command, monkeypatch):
    """The user's command line, in this process."""

    def pemirl(*arguments):
        monkeypatch.setattr(sys, "argv", ["pemirl", *arguments])
        cli.main()

    return pemirl


def test_a_task_of_ones_own_from_demonstrations_to_a_policy(pemirl, mine, capsys):
    pemirl("meta_train", *TRAIN, *FEW)
    shown = capsys.readouterr()
    assert re.search(r"training\.rollouts_per_context +2\n", shown.out)
    assert load_model(mine / "R/model.safetensors").family is not None
    pemirl("adapt_reward", *ADAPT)
    pemirl("infer", "model_file=R/model.safetensors", "demonstration=one.safetensors")
    shown = capsys.readouterr()
    assert "learned return:" in shown.out
    assert "\ndistance: " in shown.out
    assert "r(s, m) along the demonstration" in shown.out
    assert "step    99" in shown.out
    record = json.loads((mine / "A/adaptation.json").read_text())
    assert record["learned_return"] >= record["carried_over_return"]
    ways = {f"{start}-{way}" for start in ("fresh", "trained") for way in ("wide", "narrow")}
    assert set(record["tries"]) == ways
    assert f"{record['start']}-{record['exploration']}" in ways
    assert (mine / "A/policy.safetensors").is_file()
    # Nobody knows a true return here, and nothing shows one.
    assert "true" not in shown.out + shown.err


def test_what_would_run_is_shown_without_running_it(pemirl, mine, capsys):
    pemirl("meta_train", *TRAIN, *FEW, "--cfg", "job")
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["training.rollouts_per_context", "2"] in lines
    assert not (mine / "R").exists()


def test_a_card_does_not_name_the_folders_of_its_author(pemirl, mine):
    words = [
        word.replace("demonstrations=", f"demonstrations={mine}/", 1)
        if word.startswith("demonstrations=")
        else word
        for word in TRAIN
    ]
    pemirl("meta_train", *words, *FEW)
    pemirl("export_model", "model_file=R/model.safetensors", "to=shared.safetensors")
    page = (mine / "shared.md").read_text()
    assert f"| demonstrations | {mine}" not in page
    assert str(mine) not in page


def test_the_same_words_resume_and_others_are_refused(pemirl, mine, capsys):
    pemirl("meta_train", *TRAIN, *FEW)
    before = (mine / "R/model.safetensors").read_bytes()
    pemirl("meta_train", *TRAIN, *FEW)
    assert (mine / "R/model.safetensors").read_bytes() == before
    with pytest.raises(SystemExit, match="holds a run with another seed"):
        pemirl("meta_train", *TRAIN, *FEW, "seed=1")
    stored = yaml.safe_load((mine / "R/config.yaml").read_text())
    assert stored["settings"]["training"]["iterations"] == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("env=my_pendulum:maek",), r"my_pendulum.py has no function maek; it has \[.*'make'"),
        (("env=my_pendulumm:make",), "env=my_pendulumm:make: no module my_pendulumm in "),
        (("env=my_pendulum",), "env=my_pendulum: expected module:function, such as my_module:"),
        (("env=my_pendulum:T",), "has no function T"),
        (("preset=best",), "unknown preset 'best'; choose one of"),
        (("training.iteratons=3",), "unknown key training.iteratons"),
        (("seed=-1",), "seed=-1: expected greater than or equal to 0"),
        (("demonstrations=none.safetensors",), "no file none.safetensors"),
        (("preset=contrastive",), "say which components of an observation"),
        (
            ("env=my_pendulum.py:make",),
            "expected the name of a module and not of its file",
        ),
        (("env=my_pendulum:direction",), r"it is called as direction\(num_envs, seed\)"),
        (("+training.iterations=3",), "expected words like key=value"),
    ],
)
def test_a_wrong_word_is_said_and_no_model_is_made(pemirl, mine, words, message):
    with pytest.raises(SystemExit, match=f"^pemirl meta_train: .*{message}"):
        pemirl("meta_train", *TRAIN, *FEW, *words)
    assert not (mine / "R/model.safetensors").exists()


def test_an_environment_that_is_refused_does_not_block_the_right_one(pemirl, mine):
    (mine / "wrong.py").write_text("def make(num_envs, seed):\n    return None\n")
    with pytest.raises(SystemExit, match="returned a NoneType; expected a TorchRL environment"):
        pemirl("meta_train", *TRAIN, *FEW, "env=wrong:make")
    assert not (mine / "R").exists()
    pemirl("meta_train", *TRAIN, *FEW)


@pytest.mark.parametrize("name", ["meta_train", "adapt_reward", "reward_report"])
def test_help_on_an_environment_of_ones_own_explains_every_value(pemirl, capsys, name):
    pemirl(name, "env=my_pendulum:make", "--help")
    shown = capsys.readouterr().out
    module = importlib.import_module(f"pemirl_lab.commands.{name}")
    for field in dataclasses.fields(module.OwnEnvironment):
        assert field.name == "settings" or f"\n  {field.name}" in shown
    assert "make_env(num_envs, seed) returns" in shown
    assert ("training.iterations=50" in shown) == (name == "meta_train")


@pytest.mark.parametrize("words", [(), ("demonstrations=train.npz",)])
def test_actions_far_outside_of_the_environments_bounds_are_said(pemirl, mine, caplog, words):
    data = DemonstrationDataset.load(mine / "train.safetensors")
    scale = 1.0 if not words else 100.0
    np.savez(mine / "train.npz", observation=data.observation, action=scale * data.action)
    pemirl("meta_train", *TRAIN, *FEW, *words)
    assert ("actions far outside their bounds" in caplog.text) == bool(words)


def test_demonstrations_in_a_folder_are_read_and_noted(pemirl, mine):
    """As LeRobot keeps them; without actions one can be inferred from."""
    data = DemonstrationDataset.load(mine / "train.safetensors")
    data.to_minari("pendulum-v0")
    pemirl("meta_train", *TRAIN, *FEW, "demonstrations=minari:pendulum-v0", STATES)
    noted = json.loads((mine / "R/inputs.json").read_text())["demonstrations"]
    assert noted["file"].endswith("pendulum-v0")
    np.savez(mine / "one.npz", observation=data.observation[:1])
    pemirl("infer", "model_file=R/model.safetensors", "demonstration=one.npz")
    pemirl("adapt_reward", *ADAPT, "test_demonstrations=one.npz")
    pemirl("check", "minari:pendulum-v0")
    metadata = mine / "minari/pendulum-v0/data/metadata.json"
    metadata.write_text(metadata.read_text() + " ")
    with pytest.raises(SystemExit, match="is not the demonstrations that the run in R began with"):
        pemirl("meta_train", *TRAIN, *FEW, "demonstrations=minari:pendulum-v0", STATES)


def test_a_missing_word_is_named(pemirl):
    with pytest.raises(SystemExit, match=r"missing run_dir=\.\.\., demonstrations=\.\.\."):
        pemirl("meta_train", "env=my_pendulum:make")


def test_an_error_inside_the_users_module_is_the_users(mine):
    (mine / "broken_module.py").write_text("import nothing_of_this_name\n")
    with pytest.raises(ModuleNotFoundError, match="nothing_of_this_name"):
        load_make_env("broken_module:make")


def test_words_are_yaml_and_the_rest_is_the_librarys():
    words = ["env=a:b", "run_dir=R", "seed=3", "training.iterations=7", "task_space=[0,1]"]
    task = parse_words(words, OwnTask, rest=True)
    assert (task.env, task.seed) == ("a:b", 3)
    assert task.settings == {"training": {"iterations": 7}, "task_space": [0, 1]}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "several.safetensors holds 6 demonstrations: choose one with index=0 to index=5"),
        (("index=6",), "index=6: expected 0 to 5, the demonstrations there"),
    ],
)
def test_infer_takes_one_demonstration(pemirl, mine, words, message):
    pemirl("meta_train", *TRAIN, *FEW)
    (mine / "train.safetensors").rename(mine / "several.safetensors")
    given = ("model_file=R/model.safetensors", "demonstration=several.safetensors")
    with pytest.raises(SystemExit, match=message):
        pemirl("infer", *given, *words)
    pemirl("infer", *given, "index=2")


def test_infer_says_what_it_takes(pemirl, capsys):
    pemirl("infer", "--help")
    assert "model_file=" in capsys.readouterr().out


@pytest.mark.parametrize("fault", ["TypeError", "ValueError"])
def test_an_error_in_the_users_function_keeps_its_traceback(pemirl, mine, fault):
    (mine / "faulty.py").write_text(f"def make(num_envs, seed):\n    raise {fault}('mine')\n")
    with pytest.raises((TypeError, ValueError), match=r"^mine$"):
        pemirl("meta_train", *TRAIN, *FEW, "env=faulty:make")
    (mine / "wrong.py").write_text("def make(num_envs, seed):\n    return None\n")
    with pytest.raises(SystemExit, match="returned a NoneType; expected a TorchRL environment"):
        pemirl("meta_train", *TRAIN, *FEW, "env=wrong:make", "run_dir=R2")


def test_episodes_of_several_lengths_from_demonstrations_to_a_policy(pemirl, mine, capsys):
    """The example whose episodes end early, by the same words."""
    shutil.copy(PENDULUM.parents[1] / "own_puck" / "puck.py", mine / "my_puck.py")
    task = importlib.import_module("my_puck")
    try:
        task.demonstrations(12, 1).save(mine / "train.safetensors")
        task.demonstrations(2, 2).save(mine / "two.safetensors")
        pemirl("check", "train.safetensors")
        shown = capsys.readouterr().out
        assert f"12 ended by themselves before T = {task.T}, 0 were cut" in shown
        pemirl("meta_train", TRAIN[0], "env=my_puck:make", "run_dir=R", *FEW)
        assert re.search(r"model\.absorbing +True\n", capsys.readouterr().out)
        pemirl(
            "infer", "model_file=R/model.safetensors", "demonstration=two.safetensors", "index=1"
        )
        length = int(task.demonstrations(2, 2).lengths[1])
        steps = [line for line in capsys.readouterr().out.splitlines() if "  step " in line]
        assert steps[-1].split()[1] == str(length - 1)  # r along what was demonstrated
        words = ("test_demonstrations=two.safetensors", "env=my_puck:make_reversed")
        pemirl("adapt_reward", *ADAPT, *words)
        assert "learned return:" in capsys.readouterr().out
    finally:
        sys.modules.pop("my_puck", None)


def test_discrete_actions_and_named_entries_by_command(here, command, monkeypatch, capsys):
    shutil.copy(PENDULUM.parents[1] / "own_grid" / "grid.py", here / "my_grid.py")
    monkeypatch.syspath_prepend(str(here))
    task = importlib.import_module("my_grid")
    task.demonstrations(6, 1).save(here / "train.safetensors")
    task.demonstrations(1, 2).save(here / "one.safetensors")

    def pemirl(*arguments):
        monkeypatch.setattr(sys, "argv", ["pemirl", *arguments])
        cli.main()

    train = ("meta_train", "demonstrations=train.safetensors", "env=my_grid:make", *FEW)
    with pytest.raises(SystemExit, match=r"^pemirl meta_train: .*ones of \['column', 'row'"):
        pemirl(*train, "run_dir=W", "observation_keys=[row,colum]")
    pemirl(*train, "run_dir=R", "observation_keys=[column,row]")
    assert load_model(here / "R/model.safetensors").config.actions == "discrete"
    adapt = tuple(
        word.replace("my_pendulum:make_reversed", "my_grid:make_turned") for word in ADAPT
    )
    pemirl("adapt_reward", *adapt, "observation_keys=[column,row]")
    pemirl("infer", "model_file=R/model.safetensors", "demonstration=one.safetensors")
    assert "r(s, m) along the demonstration" in capsys.readouterr().out
    model = load_model(here / "R/model.safetensors")
    policy = load_policy(here / "A/policy.safetensors", model)
    assert isinstance(policy, CategoricalPolicy)
    inference = infer(model, here / "one.safetensors")
    chosen = inference.action(torch.zeros(4, model.observation_dim), policy)
    assert chosen.shape == (4, model.action_dim)
    assert (chosen.sum(-1) == 1).all()
    sys.modules.pop("my_grid", None)
