"""What YAML and overrides make of a run, and what they refuse."""

import pytest
from hydra.errors import HydraException

from .conftest import SMOKE, config


@pytest.mark.parametrize(
    ("task", "method"),
    [
        ("point_maze", "pemirl_robust"),
        ("ant", "pemirl_contrastive"),
        ("sweeper", "pemirl_contrastive"),
        ("sawyer_pusher", "pemirl_contrastive"),
    ],
)
def test_a_task_alone_chooses_the_method_that_suits_it(task, method):
    """With all settings of that method; and later recipes look for its runs."""
    for name in ("meta_train", "quickstart"):
        assert config(name, f"task={task}") == config(name, f"task={task}", f"method={method}")
        assert config(name, f"task={task}", "method=pemirl").method == "pemirl"
    run_dir = config("meta_train", f"task={task}").run_dir
    for name in ("adapt_reward", "reward_report"):
        assert config(name, f"task={task}").model_file == f"{run_dir}/model.safetensors"
    evaluated = config("evaluate", f"task={task}")
    assert evaluated.meta_run == run_dir
    assert evaluated.adaptation_run == config("adapt_reward", f"task={task}").run_dir
    assert (
        config("record_video", f"task={task}").run == config("quickstart", f"task={task}").run_dir
    )


def test_a_method_may_have_settings_of_its_own_for_a_task():
    ant, sweeper, robust = (
        config("meta_train", f"task={task}", f"method={method}")
        for task, method in (
            ("ant", "pemirl_contrastive"),
            ("sweeper", "pemirl_contrastive"),
            ("ant", "pemirl_robust"),
        )
    )
    assert (ant.initial_policy, ant.training.iterations) == ("meta_il", 100)
    assert (sweeper.initial_policy, sweeper.training.iterations) == ("meta_il", 60)
    assert (robust.initial_policy, robust.training.iterations) == ("fresh", 250)
    assert ant.model.reward_features == [13, 14]  # the task space
    assert robust.model.reward_features is None


@pytest.mark.parametrize(
    ("override", "message"),
    [("training.no_such_key=1", "no_such_key"), ("method=gail", "pemirl_robust")],
)
def test_hydra_names_what_there_is(override, message):
    with pytest.raises(HydraException, match=message):
        config("meta_train", override)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("+training.typo=1", r"unknown keys \['typo'\] for PEMIRLConfig; legal are"),
        ("demonstrations=nowhere.safetensors", "no file nowhere.safetensors"),
        ("environment=point_maze/up", "unknown task 'point_maze/up'; expected one of"),
        ("meta_il.steps=15", "steps"),
        (
            "algorithm=bc",
            r"unknown algorithm 'bc'; choose one of \['airl', 'meta_infogail', 'pemirl'",
        ),
        ("info_estimator=mine", "unknown info_estimator 'mine'; choose lemma2 or public_code"),
        ("model.reward=airl", r"unknown reward 'airl'; choose one of \('shaped', 'gail'\)"),
    ],
)
def test_bad_values_are_explained(recipe, tmp_path, monkeypatch, override, message):
    monkeypatch.chdir(tmp_path)
    values = config("meta_train", *SMOKE, "logger=null", override)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        recipe("meta_train").meta_train(values, recipe("run_folder").RunFolder(values))


def test_a_policy_of_meta_il_needs_contexts(recipe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = config("meta_train", "method=airl", "initial_policy=meta_il", *SMOKE, "logger=null")
    with pytest.raises(
        ValueError, match="initial_policy=meta_il needs contexts; got context_dim=0"
    ):
        recipe("meta_train").meta_train(values, recipe("run_folder").RunFolder(values))
