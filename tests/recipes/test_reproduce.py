"""Tables: each row composes and has what it needs; a row runs once, and shares what it may."""

import json

import pytest
from hydra.errors import HydraException

from pemirl_trl.evaluation import read
from pemirl_trl.methods import AIRLConfig, MetaILConfig, MetaInfoGAILConfig, PEMIRLConfig
from pemirl_trl.modules import ModelConfig

from .conftest import RECIPES, config

TABLES = sorted(file.stem for file in (RECIPES / "conf/table").glob("*.yaml"))
TRAINING = {"pemirl": PEMIRLConfig, "airl": AIRLConfig, "meta_infogail": MetaInfoGAILConfig}
SMOKE = (
    "preset=smoke",
    "logger=null",
    "evaluation.episodes=1",
    "meta_il.steps=10",
    "++report={episodes: 1, resolution: 6, epic_transitions: 16, epic_samples: 8, features: 8}",
)
ONE_SHOT = (
    "measure_reward=false",
    "measure.policy_generalisation=[]",
    "measure.reward_adaptation=[]",
)


def rows(table):
    swept = config("reproduce", f"table={table}", hydra=True).hydra.sweeper.params
    return swept.row.split(",")


@pytest.mark.parametrize("table", TABLES)
def test_every_row_of_a_table_composes(table, recipe):
    typed = recipe("config").typed
    for row in rows(table):
        values = config("reproduce", f"table={table}", f"row={row}")
        assert (values.row, values.table_name) == (row, table)
        typed(ModelConfig, values.model)
        typed(MetaILConfig, values.meta_il)
        if values.algorithm != "meta_il":
            typed(TRAINING[values.algorithm], values.training)
        dynamics = [values.environment, *(e for where in values.measure.values() for e in where)]
        assert {e.split("/")[1] for e in dynamics} <= values.experts.keys(), row


def test_every_row_belongs_to_one_table():
    listed = [row for table in TABLES for row in rows(table)]
    assert sorted(listed) == sorted(file.stem for file in (RECIPES / "conf/row").glob("*.yaml"))


@pytest.mark.parametrize("override", ["row=no_such_row", "table=no_such_table"])
def test_hydra_names_what_there_is(override):
    with pytest.raises(HydraException, match="(?s)no_such.*(pemirl|point_maze)"):
        config("reproduce", override)


def stamps(folder, pattern):
    return {file: file.stat().st_mtime_ns for file in folder.rglob(pattern) if file.is_file()}


@pytest.fixture
def run(recipe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def reproduce(row, *overrides):
        return recipe("reproduce").run(config("reproduce", f"row={row}", *SMOKE, *overrides))

    return reproduce


def test_rows_run_once_and_share_demonstrations_and_meta_il(run, tmp_path):
    written = run("pemirl")
    output = tmp_path / "results/point_maze/pemirl/seed0.json"
    result = read(output)
    assert json.loads(output.read_text())["schema"] == 2
    assert result.scores == written.scores
    assert (result.table, result.row, result.seed, result.split) == (
        "point_maze",
        "pemirl",
        0,
        "test",
    )
    assert {(s.setting, s.variant, len(s.per_task)) for s in result.scores if s.goals == "all"} == {
        ("one_shot", "left", 30),
        ("policy_generalisation", "right", 30),
        ("reward_adaptation", "right", 30),
    }
    assert result.reward
    assert result.curves.keys() == {"pemirl", "reward_adaptation-right"}
    assert {"meta-il", "pemirl", "reward_adaptation-right"} <= result.seconds.keys()

    everything = stamps(tmp_path, "*")
    assert run("pemirl") is None
    assert stamps(tmp_path, "*") == everything

    shared = tmp_path / "runs/reproduce/shared"
    demonstrations = stamps(shared, "*.safetensors").keys() - stamps(shared / "meta_il", "*").keys()
    assert {file.name for file in demonstrations} == {"train.safetensors", "test.safetensors"}
    before = [stamps(shared, pattern) for pattern in ("t*.safetensors", "checkpoints/**/*")]
    assert all(before)
    other = run("pemirl_no_info", *ONE_SHOT)
    assert [stamps(shared, pattern) for pattern in ("t*.safetensors", "checkpoints/**/*")] == before
    assert len(list((shared / "meta_il").iterdir())) == 1
    assert {s.setting for s in other.scores} == {"one_shot"}
    assert other.reward == {}


def test_a_seed_beyond_the_rows_own_is_not_run(run, tmp_path):
    assert run("airl", "seed=5") is None
    assert list(tmp_path.iterdir()) == []
