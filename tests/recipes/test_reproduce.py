"""Tables: each row composes and has what it needs; a row runs once, and shares what it may."""

import json

import pytest
from hydra.errors import HydraException

from pemirl_trl.evaluation import read
from pemirl_trl.methods import AIRLConfig, MetaILConfig, MetaInfoGAILConfig, PEMIRLConfig
from pemirl_trl.modules import ModelConfig, ShapedReward

from .conftest import RECIPES, config

TABLES = sorted(file.stem for file in (RECIPES / "conf/table").glob("*.yaml"))
TRAINING = {"pemirl": PEMIRLConfig, "airl": AIRLConfig, "meta_infogail": MetaInfoGAILConfig}
SMOKE = (
    "preset=smoke",
    "logger=null",
    "evaluation.episodes=1",
    "meta_il.steps=10",
    "measure.one_shot=[]",
    "measure.policy_generalisation=[]",
    "++report={episodes: 1, resolution: 6, epic_transitions: 16, epic_samples: 8, features: 8}",
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


def test_every_row_belongs_to_a_table():
    listed = {row for table in TABLES for row in rows(table)}
    assert sorted(listed) == sorted(file.stem for file in (RECIPES / "conf/row").glob("*.yaml"))


@pytest.mark.parametrize("override", ["row=no_such_row", "table=no_such_table"])
def test_hydra_names_what_there_is(override):
    with pytest.raises(HydraException, match=r"(?s)no_such.*(pemirl|point_maze)"):
        config("reproduce", override)


def stamps(folder, pattern):
    return {file: file.stat().st_mtime_ns for file in folder.rglob(pattern) if file.is_file()}


@pytest.fixture
def reproduce(recipe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return recipe("reproduce")


def smoke(row, *overrides):
    return config("reproduce", f"row={row}", *SMOKE, *overrides)


def test_a_row_is_run_once_and_shares_demonstrations_and_meta_il(reproduce, tmp_path, capsys):
    written = reproduce.run(smoke("pemirl"))
    output = tmp_path / "results/point_maze/pemirl/seed0.json"
    result = read(output)
    assert json.loads(output.read_text())["schema"] == 2
    assert result.scores == written.scores
    names = (result.table, result.row, result.seed, result.split)
    assert names == ("point_maze", "pemirl", 0, "test")
    assert {(s.setting, s.variant) for s in result.scores} == {("reward_adaptation", "right")}
    assert {len(s.per_task) for s in result.scores if s.goals == "all"} == {30}
    assert {s.env_steps["meta_training"] for s in result.scores} == {1600}
    assert result.reward
    assert result.curves.keys() == {"pemirl", "reward_adaptation-right"}
    assert {"meta-il", "pemirl", "reward_adaptation-right"} <= result.seconds.keys()

    everything = stamps(tmp_path, "*")
    capsys.readouterr()
    assert reproduce.run(smoke("pemirl")) is None
    assert "nothing to do\n" in capsys.readouterr().out
    # Settings that changed since are named, and the result is left as it is.
    assert reproduce.run(smoke("pemirl", "training.final_reward_lr=0.5")) is None
    said = "stored with training.final_reward_lr=None, now 0.5: delete results/point_maze/pemirl"
    assert said in capsys.readouterr().out
    assert stamps(tmp_path, "*") == everything

    # Another row of this seed: the same demonstrations, and the same Meta-IL, trained once.
    shared = tmp_path / "runs/reproduce/shared"
    demonstrations = stamps(shared / "demonstrations", "*.safetensors")
    assert {file.name for file in demonstrations} == {"train.safetensors", "test.safetensors"}
    trained = stamps(shared / "meta_il", "checkpoints/**/*")
    assert trained
    (folder,) = (shared / "meta_il").iterdir()
    other = smoke("meta_infogail")
    reproduce.draw_demonstrations(other)
    model, run_dir = reproduce.shared_meta_il(other)
    assert (tmp_path / run_dir) == folder
    assert isinstance(model.reward, ShapedReward)  # whatever reward the row's own model has
    assert stamps(shared / "demonstrations", "*.safetensors") == demonstrations
    assert stamps(shared / "meta_il", "checkpoints/**/*") == trained

    # Other contexts start from another Meta-IL; no contexts, from none.
    assert (tmp_path / reproduce.shared_meta_il(smoke("pemirl_context_1"))[1]) != folder
    assert reproduce.shared_meta_il(smoke("airl"))[0] is None
    assert len(list((shared / "meta_il").iterdir())) == 2


def test_a_seed_beyond_the_rows_own_is_not_run(reproduce, tmp_path):
    assert reproduce.run(smoke("airl", "seed=5")) is None
    assert list(tmp_path.iterdir()) == []
