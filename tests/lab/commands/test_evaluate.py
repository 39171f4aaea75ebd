"""Evaluation of two runs that other commands left."""

import json
import shutil

import pytest

from pemirl_lab.commands import adapt_reward, evaluate

FEW = ("evaluation.episodes=1", "logger=null", "threads=1")


@pytest.fixture
def runs(smoke, settings, here):
    """A meta-trained model and an adapted policy, in runs of their own."""
    shutil.copytree(smoke[0] / "smoke", "trained")
    tiny = ("adaptation.optimization.iterations=1", "adaptation.rollouts=60")
    model = "model_file=trained/model.safetensors"
    adapt_reward.run(*settings("adapt_reward", *FEW, *tiny, model, "run_dir=adapted"))
    return ("meta_run=trained", "adaptation_run=adapted", "run_dir=evaluated")


def test_stages_compose(settings, runs, here):
    assert json.loads((here / "adapted/curves/adaptation.json").read_text())[-1][0] == 6000
    results = evaluate.run(*settings("evaluate", *FEW, *runs))
    written = {file.stem for file in (here / "evaluated/results").glob("*.json")}
    assert {r.row for r in results} == written == {"meta_il", "pemirl_robust"}
    steps = {s.env_steps["adaptation"] for r in results for s in r.scores}
    assert steps == {0, 6000}
    ran = results[0].config["runs"]  # what the runs were, but not where they stand
    assert ran["meta_training"]["preset"] == "smoke"
    assert ran["adaptation"]["adaptation"]["rollouts"] == 60
    assert not {"run_dir", "model_file"} & {*ran["adaptation"], *ran["meta_training"]}

    for file, role in (
        ("trained/model.safetensors", "model"),
        ("adapted/policy.safetensors", "adapted policy"),
    ):
        kept = (here / file).read_bytes()
        (here / file).write_bytes(kept + b"\n")
        message = f"{file} is not the {role} that the run in evaluated began with"
        with pytest.raises(ValueError, match=message):
            evaluate.run(*settings("evaluate", *FEW, *runs))
        (here / file).write_bytes(kept)


def test_a_run_that_is_not_there_says_who_writes_it(settings, smoke, here):
    with pytest.raises(FileNotFoundError, match=r"model.safetensors: pemirl meta_train writes it"):
        evaluate.run(*settings("evaluate", "meta_run=none"))
    there = f"meta_run={smoke[0]}/smoke"
    with pytest.raises(FileNotFoundError, match=r"policy.safetensors: pemirl adapt_reward writes"):
        evaluate.run(*settings("evaluate", there, "adaptation_run=none"))
    assert list(here.iterdir()) == []
