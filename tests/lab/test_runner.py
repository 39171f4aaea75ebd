"""What a command line makes of a command: what it refuses, shows, and says when it is stopped."""

import os
import re
import shlex
import signal

import pytest
import torch

from pemirl_lab.cli import COMMANDS
from pemirl_lab.commands import quickstart
from pemirl_lab.runner import OWN_TASK
from pemirl_trl.methods import PEMIRL

from .conftest import OWN

FEW = ("preset=smoke", "threads=1", "logger=null", "run_dir=run", "training.iterations=4")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("training.iterations=abc", "training.iterations=abc: expected a valid integer"),
        ("training.policy.trpo.gamma=-1", "training.policy.trpo.gamma=-1: expected greater than"),
        (
            "training.gradient_penalty_coeff=nan",
            "training.gradient_penalty_coeff=nan: expected a finite number",
        ),
        ("initial_encoder=anything", "initial_encoder=anything: expected 'meta_il' or 'fresh'"),
        ("checkpoint_every=0", "checkpoint_every=0: expected greater than or equal to 1"),
        ("+training.typo=1", "unknown key training.typo"),
        ("+typo=1", "unknown keys typo"),
        ("algorithm=bc", "algorithm=bc: expected one of pemirl, airl, meta_infogail, meta_il"),
        ("torch_threads=0", "torch_threads=0: expected greater than or equal to 1"),
        ("evaluation.episodes=0", "evaluation.episodes=0: expected greater than or equal to 1"),
        ("seed=-1", "seed=-1: expected greater than or equal to 0"),
        ("info_estimator=mine", "info_estimator=mine: expected 'lemma2' or 'public_code'"),
        ("model.reward=airl", "model.reward=airl: expected 'shaped' or 'gail'"),
        ("device=abacus", "device=abacus: 'abacus' is no device that torch"),
        ("logger=wandb", "logger=wandb: expected 'csv' or 'tensorboard'"),
        (
            "adaptation.initial_policy=old",
            "adaptation.initial_policy=old: expected 'fresh' or 'trained'",
        ),
        (
            "environment=point_maze/up",
            "environment=point_maze/up: unknown task 'point_maze/up'; expected one of point_maze/l",
        ),
        ("results=1", "results=1: expected a valid string"),
    ],
)
def test_a_wrong_value_is_named_as_it_was_given_and_nothing_is_written(
    command, here, override, message
):
    with pytest.raises(SystemExit) as refused:
        command("quickstart", ["preset=smoke", override])
    assert str(refused.value).startswith(f"pemirl quickstart: {message}")
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(("given", "count"), [([], 1), (["torch_threads=2"], 2)])
def test_the_learner_has_as_many_threads_as_it_is_given(command, here, monkeypatch, given, count):
    seen = []
    monkeypatch.setattr(
        quickstart, "run", lambda settings, own: seen.append(torch.get_num_threads())
    )
    try:
        command("quickstart", given)
    finally:
        torch.set_num_threads(1)  # as tests/conftest.py has it
    assert seen == [count]


def test_all_wrong_values_are_named_at_once(command):
    with pytest.raises(SystemExit, match=r"checkpoint_every=0: .*; evaluation.episodes=0: "):
        command("quickstart", ["checkpoint_every=0", "evaluation.episodes=0"])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("training.no_such_key=1", "Key 'no_such_key' is not in struct"),
        ("method=gail", r"(?s)Could not find 'method/gail'.*pemirl_robust"),
        ("task=maze", r"(?s)Could not find 'task/maze'.*sawyer_pusher"),
    ],
)
def test_hydra_names_what_there_is(command, here, capsys, override, message):
    with pytest.raises(SystemExit):
        command("meta_train", [override])
    shown = capsys.readouterr().err
    assert re.search(message, shown), shown
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["row=nope"], "table point_maze has no row 'nope'; choose one of pemirl_robust, pemirl, "),
        (["table=nope"], "no table 'nope'; choose one of ablations, ant, point_maze, "),
        (["table=nope.yaml"], "no table 'nope.yaml'; choose one of ablations"),
        (["--cfg", "job", "table=ant", "row=gail"], "table ant has no row 'gail'; choose one of"),
    ],
)
def test_an_unknown_row_or_table_lists_those_that_there_are(command, here, overrides, message):
    with pytest.raises(SystemExit) as refused:
        command("reproduce", overrides)
    assert str(refused.value).startswith(f"pemirl reproduce: {message}")
    assert list(here.iterdir()) == []


def test_help_shows_groups_and_values_and_touches_nothing(command, here, capsys):
    with pytest.raises(SystemExit) as left:
        command("quickstart", ["--help"])
    assert left.value.code == 0
    shown = capsys.readouterr().out
    assert shown.startswith("pemirl quickstart: meta-train, adapt and evaluate, in one run\n")
    assert "method: airl, meta_il, meta_infogail, pemirl, pemirl_contrastive" in shown
    assert "task: ant, point_maze, sawyer_pusher, sweeper\n" in shown
    assert "imitation_coeff: 0.01\n" in shown
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_under_its_line_of_the_list(command, here, capsys, name):
    with pytest.raises(SystemExit) as left:
        command(name, ["-h"])
    assert left.value.code == 0
    shown = capsys.readouterr().out
    head = shown.splitlines()[0]
    assert head.startswith(f"pemirl {name}: {COMMANDS[name]}")
    assert (f"pemirl {name} env=my_module:make_env --help" in head) == (name in OWN_TASK)
    assert set(OWN[name].__dataclass_fields__) - {"seeds"} <= set(re.findall(r"^\w+", shown, re.M))
    assert list(here.iterdir()) == []


def test_a_configuration_is_shown_as_it_would_be_run(command, here, capsys):
    command("quickstart", ["--cfg", "job", "experiment=ant"])
    shown = capsys.readouterr().out
    assert "method: pemirl_contrastive\n" in shown
    assert "environment: ant/normal\n" in shown
    assert list(here.iterdir()) == []


def test_a_row_is_shown_with_what_sets_it_apart(command, here, capsys):
    command("reproduce", ["--cfg", "job", "table=ablations", "row=rollouts_16", "seed=3"])
    shown = capsys.readouterr().out
    assert "method: pemirl_robust\n" in shown
    assert "test_split: validation\n" in shown
    assert "  rollouts_per_context: 16\n" in shown
    assert "seed: 3\n" in shown
    command("reproduce", ["--cfg", "job", "row=airl", "training.iterations=7"])
    shown = capsys.readouterr().out
    assert "method: airl\n" in shown
    assert "  iterations: 7\n" in shown
    assert list(here.iterdir()) == []


def test_the_jobs_of_a_table_are_listed_as_commands(command, here, capsys):
    with pytest.raises(SystemExit) as left:
        command("reproduce", ["table=ant", "--list", "threads=2"])
    assert left.value.code == 0
    listed = capsys.readouterr().out.splitlines()
    assert listed[0] == "pemirl reproduce table=ant threads=2 row=meta_il seed=0"
    # Every row has its own number of seeds.
    assert sum("row=meta_il" in line for line in listed) == 10
    assert sum("row=pemirl_contrastive" in line for line in listed) == 5
    with pytest.raises(SystemExit):
        command("reproduce", ["--list", "row=airl,pemirl", "seed=4,7"])
    of_two = ["row=airl seed=4", "row=pemirl seed=4", "row=pemirl seed=7"]
    assert capsys.readouterr().out.splitlines() == [f"pemirl reproduce {row}" for row in of_two]
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interruption_says_in_a_line_how_to_go_on(command, monkeypatch, request, number):
    iteration, begun = PEMIRL.iteration, []

    def interrupted(self):
        begun.append(1)
        if len(begun) == 3:
            os.kill(os.getpid(), number)
        return iteration(self)

    monkeypatch.setattr(PEMIRL, "iteration", interrupted)
    given = [*FEW, "method=pemirl"]
    if number == signal.SIGINT:  # what Python has, unless this process was told to ignore it
        before = signal.signal(number, signal.default_int_handler)
        request.addfinalizer(lambda: signal.signal(number, before))
    with pytest.raises(SystemExit) as stopped:
        command("meta_train", given)
    again = shlex.join(["pemirl", "meta_train", *given])
    expected = f"stopped; run keeps what it has. To go on from there: {again}"
    assert str(stopped.value).strip() == expected
    command("meta_train", given)
    assert len(begun) == 3 + 2  # it did not begin anew
