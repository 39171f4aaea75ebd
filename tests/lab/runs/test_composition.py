"""What wins over what, and what goes together."""

import dataclasses

import pytest
import yaml
from hydra.errors import HydraException

from pemirl_lab.runs.composition import CONF, compose, override_key, plain
from pemirl_lab.runs.validation import leaves
from pemirl_trl.methods import METHODS, AdaptationConfig

TASKS = sorted(file.stem for file in (CONF / "task").glob("*.yaml"))
EXPERIMENTS = sorted(file.stem for file in (CONF / "experiment").glob("*.yaml"))


def read(file):
    return yaml.safe_load((CONF / file).read_text(encoding="utf-8"))


def test_methods_are_the_librarys_whole():
    for name, method in METHODS.items():
        composed = plain(compose("meta_train", [f"method={name}"]))
        expected = dict(leaves({"method": name, **dataclasses.asdict(method)}))
        # Point-Maze's budgets are the library's defaults.
        got = {key: composed_value(composed, key) for key in expected}
        assert got == {key: value if not isinstance(value, tuple) else list(value)
                       for key, value in expected.items()}  # fmt: skip
    defaults = dict(leaves(dataclasses.asdict(AdaptationConfig())))
    assert dict(leaves(plain(compose("meta_train"))["adaptation"])) == defaults


def composed_value(node, key):
    for part in key.split("."):
        node = node[part]
    return node


def test_later_wins():
    """config < method < task < experiment < preset < the command line."""

    def iterations(*overrides):
        return compose("meta_train", overrides).training.iterations

    assert iterations() == METHODS["pemirl"].training.iterations == 50
    assert iterations("task=ant") == 250
    assert iterations("experiment=ant") == 100
    assert iterations("experiment=ant", "preset=smoke") == 2
    assert iterations("experiment=ant", "preset=smoke", "training.iterations=7") == 7
    assert compose("meta_train", ["seed=1", "seed=2"]).seed == 2


def test_a_smoke_run_is_not_in_the_way_of_the_real_one():
    def folder(*overrides):
        return compose("quickstart", overrides).run_dir

    assert folder("preset=smoke") == folder().replace("runs/", "runs/smoke/", 1)
    assert compose("adapt_reward", ["preset=smoke"]).model_file.startswith("runs/smoke/meta_train/")


def test_a_method_may_have_settings_of_its_own_for_a_task():
    ant, sweeper, robust = (
        compose("meta_train", overrides)
        for overrides in (
            ["experiment=ant"],
            ["experiment=sweeper"],
            ["task=ant", "method=pemirl_robust"],
        )
    )
    assert (ant.initial_policy, ant.training.iterations) == ("meta_il", 100)
    assert (sweeper.initial_policy, sweeper.training.iterations) == ("meta_il", 60)
    assert (robust.initial_policy, robust.training.iterations) == ("fresh", 250)
    assert (ant.reward_reads, robust.reward_reads) == ("task_space", "observation")


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_commands_look_for_the_runs_of_those_before_them(experiment):
    def composed(command):
        return compose(command, [f"experiment={experiment}"])

    run_dir = composed("meta_train").run_dir
    assert experiment in run_dir
    for name in ("adapt_reward", "reward_report"):
        assert composed(name).model_file == f"{run_dir}/model.safetensors"
    assert composed("evaluate").meta_run == run_dir
    assert composed("evaluate").adaptation_run == composed("adapt_reward").run_dir
    assert composed("record_video").run == composed("quickstart").run_dir


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_an_experiment_is_what_it_says_it_is(experiment):
    """It names its task and method twice: for Hydra, and for who reads the configuration."""
    values = read(f"experiment/{experiment}.yaml")
    chosen = {
        key.removeprefix("override /"): value
        for default in values["defaults"]
        for key, value in default.items()
    }
    assert values["experiment"] == {"name": experiment, **chosen}
    assert chosen["task"] in TASKS
    assert chosen["method"] in METHODS
    composed = compose("meta_train", [f"experiment={experiment}"])
    assert (composed.task, composed.method) == (chosen["task"], chosen["method"])


def test_every_task_has_the_experiment_of_its_name():
    assert EXPERIMENTS == TASKS


@pytest.mark.parametrize("task", TASKS)
def test_a_task_never_replaces_what_makes_a_method(task):
    """A method is what it sets apart from the paper's; a task's budgets are of every method."""
    paper = dict(leaves(dataclasses.asdict(METHODS["pemirl"])))
    of_methods = {
        name
        for method in METHODS.values()
        for name, value in leaves(dataclasses.asdict(method))
        if name not in paper or paper[name] != value
    }
    assert {"algorithm", "training.gradient_penalty_coeff", "model.context_dim"} <= of_methods
    values = read(f"task/{task}.yaml")
    assert values["task"] == task
    assert of_methods & {name for name, _ in leaves(values)} == set()


def test_what_there_is_not_is_refused_with_what_there_is():
    with pytest.raises(HydraException, match=r"(?s)method/gail.*pemirl_robust"):
        compose("meta_train", ["method=gail"])
    with pytest.raises(HydraException, match="no_such_key"):
        compose("meta_train", ["training.no_such_key=1"])


@pytest.mark.parametrize(
    ("override", "key"),
    [("a.b=1", "a.b"), ("+a.b=1=2", "a.b"), ("++a=1", "a"), ("~experiment", "experiment")],
)
def test_what_an_override_is_about(override, key):
    assert override_key(override) == key
