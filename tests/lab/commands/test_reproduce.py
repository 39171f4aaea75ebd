"""A row runs once, and shares what it may."""

import json

import pytest

from pemirl_lab.commands import reproduce
from pemirl_lab.results import read
from pemirl_trl.modules import ShapedReward

SMOKE = (
    "preset=smoke",
    "logger=null",
    "evaluation.episodes=1",
    "meta_il.steps=10",
    "measure.one_shot=[]",
    "measure.policy_generalisation=[]",
)


def stamps(folder, pattern):
    return {file: file.stat().st_mtime_ns for file in folder.rglob(pattern) if file.is_file()}


@pytest.fixture
def smoke_row(row_settings, here):
    return lambda row, *overrides: row_settings("point_maze", row, *SMOKE, *overrides)


def test_a_row_is_run_once_and_shares_demonstrations_and_meta_il(smoke_row, here, capsys):
    written = reproduce.run(*smoke_row("pemirl"))
    output = here / "results/point_maze/pemirl/seed0.json"
    result = read(output)
    assert json.loads(output.read_text())["schema"] == 2
    assert result.scores == written.scores
    names = (result.table, result.row, result.seed, result.split)
    assert names == ("point_maze", "pemirl", 0, "test")
    assert {(s.setting, s.variant) for s in result.scores} == {("reward_adaptation", "right")}
    assert {len(s.per_task) for s in result.scores if s.goals == "all"} == {30}
    assert {s.env_steps["meta_training"] for s in result.scores} == {1600}
    assert {"r/map/spearman/mean", "context/r2"} <= {*result.reward}
    assert result.curves.keys() == {"pemirl", "reward_adaptation-right"}
    assert {"meta-il", "pemirl", "reward_adaptation-right"} <= result.seconds.keys()

    everything = stamps(here, "*")
    capsys.readouterr()
    assert reproduce.run(*smoke_row("pemirl")) is None
    assert "nothing to do\n" in capsys.readouterr().out
    # Settings that changed since are named, and the result is left as it is.
    assert reproduce.run(*smoke_row("pemirl", "training.final_reward_lr=0.5", "threads=2")) is None
    said = "stored with training.final_reward_lr=None, now 0.5: delete results/point_maze/pemirl"
    assert said in capsys.readouterr().out
    assert stamps(here, "*") == everything

    # Another row of this seed: the same demonstrations, and the same Meta-IL, trained once.
    shared = here / "runs/smoke/reproduce/shared"
    demonstrations = stamps(shared / "demonstrations", "*.safetensors")
    assert {file.name for file in demonstrations} == {"train.safetensors", "test.safetensors"}
    trained = stamps(shared / "meta_il", "checkpoints/**/*")
    assert trained
    (folder,) = (shared / "meta_il").iterdir()
    other = smoke_row("meta_infogail")
    reproduce.draw_demonstrations(*other)
    model, run_dir = reproduce.shared_meta_il(*other)
    assert (here / run_dir) == folder
    assert isinstance(model.reward, ShapedReward)  # whatever reward the row's own model has
    assert stamps(shared / "demonstrations", "*.safetensors") == demonstrations
    assert stamps(shared / "meta_il", "checkpoints/**/*") == trained

    # Other contexts start from another Meta-IL; no contexts, from none.
    assert (here / reproduce.shared_meta_il(*smoke_row("pemirl_context_1"))[1]) != folder
    assert reproduce.shared_meta_il(*smoke_row("airl"))[0] is None
    assert len(list((shared / "meta_il").iterdir())) == 2


def test_a_trained_row_is_confirmed_on_other_tasks_and_another_shift(row_settings, here):
    def row(*overrides):
        return row_settings(
            "sweeper", "pemirl", *SMOKE, "confirm_environment=sweeper/normal", *overrides
        )

    tested = reproduce.run(*row())
    trained = stamps(here / "runs", "checkpoints/pemirl/**/*")
    confirmed = reproduce.run(*row("confirm=true"))
    assert (
        stamps(here / "runs", "checkpoints/pemirl/**/*") == trained
    )  # the model is that of before
    assert read(here / "results/sweeper/pemirl/seed0.json").scores == tested.scores
    stored = read(here / "results/sweeper_confirm/pemirl/seed0.json")
    assert stored.scores == confirmed.scores
    assert (stored.table, stored.row, stored.split) == ("sweeper_confirm", "pemirl", "confirm")
    assert [(s.setting, s.variant) for s in stored.scores] == [("reward_adaptation", "normal")]
    steps = {s.env_steps["meta_training"] for r in (tested, confirmed) for s in r.scores}
    assert len(steps) == 1
    assert stored.config["test_environment"] == "sweeper/normal"
    assert stored.config["test_demonstrations"].endswith("confirm.safetensors")
    assert reproduce.run(*row("confirm=true")) is None


def test_a_seed_beyond_the_rows_own_is_not_run(smoke_row, here, capsys):
    assert reproduce.run(*smoke_row("airl", "seed=5")) is None
    assert capsys.readouterr().out == "airl, seed 5: nothing to do\n"
    assert list(here.iterdir()) == []


TABLE = """
seeds: 2
overrides: [task=point_maze, preset=smoke, evaluation.episodes=1, logger=null, meta_il.steps=10]
rows:
  imitation:
    label: Imitation
    seeds: 1
    overrides: [method=meta_il, "measure.reward_adaptation=[]"]
"""


def test_the_command_runs_a_table_of_ones_own(command, here, capsys):
    """Jobs run here one after the other; by default joblib runs them side by side."""
    (here / "mine.yaml").write_text(TABLE, encoding="utf-8")
    given = ["table=mine.yaml", "hydra/launcher=basic", "seed=0,1"]
    command("reproduce", given)
    result = read(here / "results/mine/imitation/seed0.json")
    assert (result.table, result.row, result.config["method"]) == ("mine", "imitation", "meta_il")
    assert {s.setting for s in result.scores} == {"one_shot", "policy_generalisation"}
    assert "imitation, seed 1: nothing to do\n" in capsys.readouterr().out
    assert len(list((here / "results").rglob("*.json"))) == 1
