"""The recipes as a user runs them: in a process, from another folder."""

import json
import os
import pathlib
import subprocess
import sys

import pytest

from pemirl_trl.evaluation import read
from pemirl_trl.pretrained import load_model

RECIPES = pathlib.Path(__file__).parents[2] / "recipes"


def run(name, *overrides, cwd, check=True):
    return subprocess.run(
        [sys.executable, str(RECIPES / f"{name}.py"), *overrides],
        cwd=cwd,
        check=check,
        capture_output=True,
        text=True,
        env=os.environ | {"MUJOCO_GL": "disable", "CUDA_VISIBLE_DEVICES": ""},
    )


@pytest.fixture(scope="module")
def quickstart(tmp_path_factory):
    cwd = tmp_path_factory.mktemp("run")
    done = run("quickstart", "preset=smoke", "threads=1", "run_dir=smoke", cwd=cwd)
    return cwd, done


def test_quickstart_prints_a_table_and_leaves_its_files(quickstart):
    cwd, done = quickstart
    assert "| point_maze right | reward_adaptation | x_in_0.1_0.4 |" in done.stdout + done.stderr
    folder = cwd / "smoke"
    for name in (
        "config.yaml",
        "versions.json",
        "seconds.json",
        "model.safetensors",
        "meta_il.safetensors",
        "policy.safetensors",
        "figures/reward_maps.png",
        "figures/learning_curve.png",
        "metrics/scalars",
    ):
        assert (folder / name).exists(), name
    results = [read(file) for file in (folder / "results").glob("*.json")]
    assert {(r.method, r.setting) for r in results} == {
        ("meta_il", "one_shot"),
        ("meta_il", "policy_generalisation"),
        ("pemirl_blurred", "one_shot"),
        ("pemirl_blurred", "policy_generalisation"),
        ("pemirl_blurred", "reward_adaptation"),
    }
    assert {len(r.returns["per_task"]) for r in results if r.goals == "all"} == {30}
    assert all(r.config["preset"] == "smoke" for r in results)


def test_a_finished_run_is_not_trained_again(quickstart):
    cwd, _ = quickstart
    weights = (cwd / "smoke/model.safetensors").read_bytes()
    curve = json.loads((cwd / "smoke/curves/pemirl_blurred.json").read_text())
    run("quickstart", "preset=smoke", "threads=1", "run_dir=smoke", cwd=cwd)
    assert (cwd / "smoke/model.safetensors").read_bytes() == weights
    assert json.loads((cwd / "smoke/curves/pemirl_blurred.json").read_text()) == curve
    assert [steps for steps, _ in curve] == [800, 1600]


def test_recipes_compose(quickstart):
    """adapt_reward.py and evaluate.py take what quickstart's stages left."""
    cwd, _ = quickstart
    adapted = run(
        "adapt_reward",
        "model_file=smoke/model.safetensors",
        "adaptation.optimization.iterations=1",
        "adaptation.rollouts_per_context=2",
        "threads=1",
        "run_dir=adapted",
        cwd=cwd,
    )
    assert "adapted on 6,000 environment steps" in adapted.stdout + adapted.stderr
    folders = ["meta_run=smoke", "adaptation_run=adapted", "run_dir=evaluated"]
    run("evaluate", *folders, "evaluation.episodes=1", "threads=1", cwd=cwd)
    assert len(list((cwd / "evaluated/results").glob("*.json"))) == 10
    assert load_model(cwd / "smoke/model.safetensors").config.context_dim == 3


def test_a_folder_of_another_configuration_is_refused(quickstart):
    cwd, _ = quickstart
    arguments = ["preset=smoke", "threads=1", "run_dir=smoke", "seed=7"]
    refused = run("quickstart", *arguments, cwd=cwd, check=False)
    assert refused.returncode != 0
    assert "holds a run with another seed" in refused.stderr


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("pemirl.no_such_key=1", "no_such_key"),
        ("+pemirl.typo=1", "unknown keys ['typo'] for PEMIRLConfig; legal are"),
        ("method=gail", "Available options"),
        ("demonstrations=nowhere.safetensors", "no file nowhere.safetensors"),
        ("environment=point_maze/up", "unknown task 'point_maze/up'; expected one of"),
    ],
)
def test_bad_overrides_are_explained(tmp_path, override, message):
    arguments = ["preset=smoke", "threads=1", override]
    refused = run("meta_train", *arguments, cwd=tmp_path, check=False)
    assert refused.returncode != 0
    assert message in refused.stderr


@pytest.mark.parametrize("name", ["train_expert", "collect_demos", "evaluate", "quickstart"])
def test_help_lists_every_value(tmp_path, name):
    text = run(name, "--help", cwd=tmp_path).stdout
    assert "override any as key=value" in text
    assert "seed: 0" in text
    assert list(tmp_path.iterdir()) == []


def test_expert_and_demonstrations(tmp_path):
    """A tiny expert and its demonstrations, as the data card's commands make them."""
    tiny = ["optimization.iterations=1", "tasks_per_batch=2", "rollouts_per_task=2"]
    files = ["output=expert.safetensors", "run_dir=expert", "threads=1", "evaluation.episodes=1"]
    trained = run("train_expert", *tiny, *files, cwd=tmp_path)
    assert "expert on point_maze/left" in trained.stdout + trained.stderr
    arguments = ["expert=expert.safetensors", "output=demos.safetensors", "split=train"]
    run("collect_demos", *arguments, "per_task=2", "threads=1", cwd=tmp_path)
    again = run("adapt_reward", "model_file=none.safetensors", cwd=tmp_path, check=False)
    assert "no file none.safetensors" in again.stderr
    assert (tmp_path / "demos.safetensors").exists()
