"""The recipes: once as a user runs them, in a process of its own; then stage by stage."""

import json
import os
import re
import subprocess
import sys

import pytest
import torch
from imageio_ffmpeg import get_ffmpeg_exe
from tensordict import TensorDict

from pemirl_trl.evaluation import read
from pemirl_trl.files import read_metadata
from pemirl_trl.methods import AveragedReward
from pemirl_trl.modules import GAILDiscriminator, NoContext
from pemirl_trl.objectives import InfoLoss
from pemirl_trl.pretrained import load_model

from .conftest import RECIPES, SMOKE, config

WITHOUT_ADAPTATION = {("one_shot", "left"), ("policy_generalisation", "right")}


def run(name, *overrides, cwd):
    return subprocess.run(
        [sys.executable, str(RECIPES / f"{name}.py"), *overrides],
        cwd=cwd,
        capture_output=True,
        text=True,
        env=os.environ | {"MUJOCO_GL": "disable", "CUDA_VISIBLE_DEVICES": ""},
    )


@pytest.fixture(scope="module")
def smoke(tmp_path_factory):
    """A finished quickstart, run by the user's command: its folder, and what it printed."""
    cwd = tmp_path_factory.mktemp("run")
    done = run("quickstart", *SMOKE, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return cwd, done.stdout + done.stderr


def test_quickstart_prints_a_table_and_leaves_its_files(smoke):
    cwd, printed = smoke
    cell = r"\| -\d+\.\d\d \(-?\d+\.\d{3}\) "  # return and normalised return of one seed
    assert re.search(rf"\| pemirl_robust \| 1 {cell * 6}\|", printed)
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
        assert (cwd / "smoke" / name).exists(), name
    results = {file.stem: read(file) for file in (cwd / "smoke/results").glob("*.json")}
    assert {row: {(s.setting, s.variant) for s in r.scores} for row, r in results.items()} == {
        "meta_il": WITHOUT_ADAPTATION,
        "pemirl_robust": WITHOUT_ADAPTATION | {("reward_adaptation", "right")},
    }
    scores = [s for r in results.values() for s in r.scores]
    assert {len(s.per_task) for s in scores if s.goals == "all"} == {30}
    assert all(r.config["preset"] == "smoke" for r in results.values())
    assert results["pemirl_robust"].curves.keys() == {"pemirl_robust", "adaptation"}


def test_a_finished_run_is_not_trained_again(smoke, recipe, monkeypatch):
    cwd, _ = smoke
    monkeypatch.chdir(cwd)
    weights = (cwd / "smoke/model.safetensors").read_bytes()
    curve = (cwd / "smoke/curves/pemirl_robust.json").read_text()
    recipe("quickstart").quickstart(config("quickstart", *SMOKE))
    assert (cwd / "smoke/model.safetensors").read_bytes() == weights
    assert (cwd / "smoke/curves/pemirl_robust.json").read_text() == curve
    assert [steps for steps, _ in json.loads(curve)] == [800, 1600]


def test_results_do_not_depend_on_the_number_of_threads(smoke, recipe, monkeypatch):
    cwd, _ = smoke
    monkeypatch.chdir(cwd)
    two = config("quickstart", "preset=smoke", "threads=2", "run_dir=two_threads", "logger=null")
    recipe("meta_train").meta_train(two, recipe("run_folder").RunFolder(two))
    weights = (cwd / "smoke/model.safetensors").read_bytes()
    assert (cwd / "two_threads/model.safetensors").read_bytes() == weights


def test_stages_compose(smoke, recipe, monkeypatch):
    """adapt_reward.py and evaluate.py take what other runs left."""
    cwd, _ = smoke
    monkeypatch.chdir(cwd)
    folder = recipe("run_folder").RunFolder
    tiny = ("adaptation.optimization.iterations=1", "adaptation.rollouts=60")
    adapted = config("adapt_reward", *tiny, "run_dir=adapted", "logger=null")
    model = load_model(cwd / "smoke/model.safetensors")
    recipe("adapt_reward").adapt(adapted, folder(adapted), model)
    assert json.loads((cwd / "adapted/curves/adaptation.json").read_text())[-1][0] == 6000
    evaluated = config("evaluate", "evaluation.episodes=1", "run_dir=evaluated", "logger=null")
    runs = (cwd / "smoke", cwd / "adapted")
    results = recipe("evaluate").evaluate(evaluated, folder(evaluated), *runs)
    written = {file.stem for file in (cwd / "evaluated/results").glob("*.json")}
    assert {r.row for r in results} == written == {"meta_il", "pemirl_robust"}
    steps = {s.env_steps["adaptation"] for r in results for s in r.scores}
    assert steps == {0, 6000}
    ran = results[0].config["runs"]  # what the runs were, but not where they stand
    assert ran["meta_training"]["preset"] == "smoke"
    assert ran["adaptation"]["adaptation"]["rollouts"] == 60
    assert not {"run_dir", "model_file"} & {*ran["adaptation"], *ran["meta_training"]}


METHODS = ["pemirl", "pemirl_contrastive", "airl", "meta_infogail", "pemirl_no_info"]


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_built_and_runs(method, recipe, tmp_path, monkeypatch):
    """The default, pemirl_robust, is what the quickstart ran."""
    monkeypatch.chdir(tmp_path)
    few = ("training.batch.trajectories=10", "meta_il.steps=10")
    values = config("meta_train", f"method={method}", *SMOKE, *few, "logger=null")
    trained = recipe("meta_train").meta_train(values, recipe("run_folder").RunFolder(values))
    model = load_model("smoke/model.safetensors")
    for name, value in trained.state_dict().items():
        assert torch.equal(model.state_dict()[name], value), name
    facts = read_metadata("smoke/model.safetensors")
    assert (facts["method"], facts["env_steps"]) == (method, "1600")
    # Meta-IL comes first for whoever has contexts.
    assert isinstance(model.encoder, NoContext) == (method == "airl")
    assert os.path.exists("smoke/meta_il.safetensors") == (method != "airl")
    assert isinstance(model.reward, GAILDiscriminator) == (method == "meta_infogail")
    if method != "airl":
        before = load_model("smoke/meta_il.safetensors").encoder.state_dict()
        after = model.encoder.state_dict()
        still = all(torch.equal(after[name], value) for name, value in before.items())
        assert still == (method in ("pemirl_no_info", "pemirl_contrastive"))


def test_runs_are_looked_for_from_here_alone(recipe, tmp_path, monkeypatch):
    """Another checkout's model would be taken silently, if the repository's folder counted too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(recipe("domains"), "ROOT", tmp_path / "repository")
    (tmp_path / "repository/runs").mkdir(parents=True)
    (tmp_path / "repository/runs/model.safetensors").touch()
    assert recipe("domains").data_file("runs/model.safetensors").is_file()
    with pytest.raises(FileNotFoundError, match=rf"{tmp_path}/runs/model.*: meta_train.py writes"):
        recipe("domains").run_file("runs/model.safetensors", "meta_train.py")


def test_adaptation_starts_from_the_policy_that_was_asked_for(smoke, recipe):
    model = load_model(smoke[0] / "smoke/model.safetensors")
    start = recipe("adapt_reward").initial_policy
    batch = TensorDict({"observation": torch.randn(5, 2), "context": torch.randn(5, 3)}, [5])
    kept = model.policy.get_dist(batch).mean
    for which, same in (("fresh", False), ("trained", True)):
        values = config("adapt_reward", f"adaptation.initial_policy={which}")
        policy, activation = start(values, model)
        assert torch.equal(policy.get_dist(batch).mean, kept) == same
        assert activation == {"fresh": "tanh", "trained": "relu"}[which]
    with pytest.raises(ValueError, match="initial_policy 'old'; choose fresh or trained"):
        start(config("adapt_reward", "adaptation.initial_policy=old"), model)


def test_the_options_of_a_method_reach_it(recipe):
    """An averaged reward; the information term of the public code."""
    values = config(
        "meta_train", "preset=smoke", "reward_average_decay=0.9", "info_estimator=public_code"
    )
    demonstrations = recipe("meta_train").load_demonstrations(values)
    model = recipe("meta_train").new_model(values, demonstrations)
    method = recipe("methods").build(values, model, demonstrations)
    assert isinstance(method, AveragedReward)
    assert method.model is model
    assert isinstance(method.method._info_loss, recipe("public_code").PublicCodeInfoLoss)
    values = config("meta_train", "preset=smoke", "method=pemirl")
    plain = recipe("methods").build(values, model, demonstrations)
    assert isinstance(plain._info_loss, InfoLoss)


@pytest.mark.skipif(
    os.environ.get("MUJOCO_GL", "disable") == "disable", reason="no OpenGL library to render with"
)
@pytest.mark.parametrize("policy", ["adapted", "expert"])
def test_a_policy_is_filmed(smoke, recipe, monkeypatch, policy):
    monkeypatch.chdir(smoke[0])
    values = config(
        "record_video", "run=smoke", f"policy={policy}", "tasks=2", "output=film.mp4", "width=64",
        "height=48",
    )  # fmt: skip
    recipe("record_video").record_video(values)
    decode = [get_ffmpeg_exe(), "-i", "film.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    film = subprocess.run(decode, capture_output=True, check=True).stdout
    frame = len(film) // 200  # two episodes of 100 steps
    assert len(film) == 200 * frame > 0
    assert film[:frame] != film[99 * frame : 100 * frame]


def test_there_is_no_other_policy_to_film(recipe):
    with pytest.raises(ValueError, match=r"unknown policy 'best'; choose one of \['adapted', 'exp"):
        recipe("record_video").record_video(config("record_video", "policy=best"))


def test_a_folder_of_another_configuration_is_refused(smoke, recipe, monkeypatch):
    monkeypatch.chdir(smoke[0])
    with pytest.raises(ValueError, match="holds a run with another seed"):
        recipe("run_folder").RunFolder(config("quickstart", *SMOKE, "seed=7"))


def test_seconds_are_recorded_before_the_end_and_added_up(recipe, tmp_path, monkeypatch):
    """A process that is killed runs no ``finally``: what it recorded so far has to stand there."""
    monkeypatch.chdir(tmp_path)
    clock = iter([10.0, 13.0, 13.5, 100.0, 101.0])
    recipes = recipe("run_folder")
    monkeypatch.setattr(recipes.time, "perf_counter", lambda: next(clock))
    values = config("quickstart", *SMOKE, "logger=null")
    killed = recipes.RunFolder(values)
    with killed.timed("stage") as record:
        record()
        assert json.loads(killed.file("seconds.json").read_text()) == {"stage": 3.0}
    with recipes.RunFolder(values).timed("stage"):
        pass
    assert json.loads(killed.file("seconds.json").read_text()) == {"stage": 4.5}


def test_help_lists_every_value_and_touches_nothing(tmp_path):
    text = run("quickstart", "--help", cwd=tmp_path).stdout
    assert "override any as key=value" in text
    assert "imitation_coeff: 0.01" in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "task",
    [
        "sweeper",
        pytest.param("ant", marks=pytest.mark.long),
        pytest.param("sawyer_pusher", marks=pytest.mark.long),
    ],
)
def test_every_domain_runs_from_expert_to_evaluation(recipe, tmp_path, monkeypatch, task):
    """By ``task=...`` alone, but for sizes and places."""
    monkeypatch.chdir(tmp_path)
    folder = recipe("run_folder").RunFolder
    which = (f"task={task}", "logger=null", "threads=1", "evaluation.episodes=1")
    facts = config("meta_train", *which)
    places = {v: f"{v}_expert.safetensors" for v in facts.experts}
    experts = tuple(f"experts.{v}={place}" for v, place in places.items())
    for variant, place in places.items():
        tiny = ("optimization.iterations=1", "tasks_per_batch=2", "rollouts_per_task=1")
        values = config("train_expert", *which, *tiny, *experts, f"environment={task}/{variant}")
        recipe("train_expert").train_expert(values, folder(values))
        assert os.path.exists(place)
    files = {"demonstrations": "train.safetensors", "test_demonstrations": "test.safetensors"}
    for (key, place), split in zip(files.items(), (facts.train_split, "test"), strict=True):
        few = ("per_task=1", f"split={split}", f"output={place}")
        recipe("collect_demos").collect_demos(config("collect_demos", *which, *experts, *few))
        assert os.path.exists(files[key])
    given = tuple(f"{key}={place}" for key, place in files.items())
    smallest = ("preset=smoke", "run_dir=run", "demonstrations_per_task=1", "adaptation.rollouts=2")
    values = config("quickstart", *which, *experts, *given, *smallest)
    # An expert of one iteration may be no better than random actions: normalisation refuses it.
    monkeypatch.setattr(recipe("scoring").Scorer, "references", better_than_random)
    recipe("quickstart").quickstart(values)
    result = read(f"run/results/{values.method}.json")
    assert result.task == task
    settings = {(s.setting, s.variant) for s in result.scores}
    trained, shifted = (values[k].split("/")[1] for k in ("environment", "test_environment"))
    assert settings == {
        ("one_shot", trained),
        ("policy_generalisation", shifted),
        ("reward_adaptation", shifted),
    }
    assert "context/r2" in result.reward
    assert ("context/accuracy" in result.reward) == (task == "ant")
    assert {s.goals for s in result.scores} == {"all", *values.subsets}
    assert not os.path.exists("run/figures/reward_maps.png")
    page = config("reward_report", *which, *given, "run_dir=page")
    model = load_model("run/model.safetensors")
    with pytest.raises(ValueError, match=f"task={task} is not planar"):
        recipe("reward_report").write_report(page, folder(page), model)


def better_than_random(self, environment):
    count = len(self.demonstrations.tasks())
    return {"expert": torch.ones(count), "random": torch.zeros(count)}
