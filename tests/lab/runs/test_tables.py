"""Every row composes and has what it needs; those that were published compose as they ran."""

import json
from pathlib import Path

import pytest

import pemirl_envs
from pemirl_lab.runs.tables import read_table, table_names
from pemirl_lab.runs.validation import leaves

RESULTS = Path(__file__).parents[3] / "results"
RENAMED = {
    # Of all tasks together, and shared evenly by them: it was of each of them.
    "adaptation.rollouts_per_context": "adaptation.rollouts",
    # The stretch over which a policy is annealed is named alike everywhere, by its two ends.
    "training.policy.anneal_from": "training.policy.anneal_begin",
    "adaptation.optimization.anneal_fraction": "adaptation.optimization.anneal_finish",
    # What names a table on the command line names it in the file.
    "table_name": "table",
}
METHOD_RENAMED = {
    # The setting that holds on every domain is the method; the other is named for what it does.
    "pemirl_bounded": "pemirl",
    "pemirl": "pemirl_rescaled",
}
ROW_RENAMED = {
    **METHOD_RENAMED,
    "airl": "airl_held",
    **{
        f"pemirl_{what}": f"pemirl_rescaled_{what}"
        for what in ("no_info", "context_1", "context_5", "stochastic")
    },
}
IN_THE_TASK = ("planar", "task_key", "task_space")
"""Facts that are no settings any more: the task itself has them."""
FREE = ("seed", "seeds", "threads", "logger", "checkpoint_every", "confirm")
"""Of the seed, and of what results do not depend on."""
UNSEEN_TASKS = {"test": 30, "validation": 15}  # of Point-Maze
PUBLISHED = sorted(
    file
    for table in table_names()
    for file in (RESULTS / table).glob("*/seed*.json")
    if file.parent.name in read_table(table).rows
)


@pytest.mark.parametrize("table", table_names())
def test_every_row_of_a_table_parses(table, row_settings):
    for row in read_table(table).rows:
        given, own = row_settings(table, row)
        assert (own.row, own.table, own.seeds) == (row, table, read_table(table).seeds_of(row))
        assert own.results == f"results/{table}/{row}"
        dynamics = [given.environment, *(e for where in own.measure.values() for e in where)]
        for name in dynamics:
            assert given.expert_file(name), row
        assert own.test_split in pemirl_envs.get_task(given.environment).splits


def composed(table, row):
    """A row's configuration by dotted names, with the task's facts where they once stood."""
    config = read_table(table).compose(row)
    task = pemirl_envs.get_task(config["environment"])
    facts = {"planar": task.planar, "task_key": task.task_key}
    facts["task_space"] = task.task_space_indices()
    if config["reward_reads"] == "task_space":  # resolved when the model is made
        config["model"]["reward_features"] = facts["task_space"]
    return dict(leaves(config | facts))


@pytest.fixture(scope="module")
def published():
    return {
        folder: composed(folder.parent.name, folder.name)
        for folder in {f.parent for f in PUBLISHED}
    }


def test_published_rows_compose_as_they_ran(published):
    assert len(published) >= 40
    for file in PUBLISHED:
        content = json.loads(file.read_text(encoding="utf-8"))
        now, stored = published[file.parent], as_named_now(content)
        wrong = {
            name: (value, now.get(RENAMED.get(name, name), "gone"))
            for name, value in stored.items()
            if not_as_it_ran(name, value, now, content["seed"])
        }
        assert wrong == {}, file


def as_named_now(content):
    """The stored configuration, with today's names of its row and method if they had others."""
    stored, row = dict(leaves(content["config"])), content["row"]
    if stored.get("reward_reads") == "task_space":  # which of them: resolved with the model, later
        del stored["model.reward_features"]
    if stored["row"] == row:
        return stored
    assert ROW_RENAMED[stored["row"]] == row
    for name in ("results", "run_dir"):
        stored[name] = stored[name].replace(f"/{stored['row']}", f"/{row}")
    method = stored["method"]
    return stored | {"row": row, "method": METHOD_RENAMED.get(method, method)}


def not_as_it_ran(name, value, now, seed):
    if name in FREE:
        return False
    if now["method"] == "meta_il" and name.startswith("training."):
        # It trains nothing by adversaries: its training has those settings alone that all share.
        return name in now and now[name] != value and name != "training.policy.imitation_coeff"
    if (name, value) == ("training.info_contexts", 6):
        return now[name] < 6  # capped by the contexts of a batch, which are 6: the same draws
    if name == "task_space" and not value:
        return False  # Point-Maze had none: nothing read it
    if name == "adaptation.rollouts_per_context":
        value *= UNSEEN_TASKS[now["test_split"]]
    if isinstance(value, str):
        value = value.replace(f"seed{seed}", "seed0")
    return now.get(RENAMED.get(name, name), "gone") != value


def test_of_two_overrides_of_a_key_the_later_counts():
    """The table's, then the row's, then the command line's."""
    table = read_table("point_maze")
    assert table.compose("pemirl")["measure_reward"] is True
    assert table.compose("meta_il")["measure_reward"] is False
    assert table.compose("meta_il", ["measure_reward=true"])["measure_reward"] is True
    assert table.compose("pemirl_context_5")["model"]["context_dim"] == 5
    assert table.compose("pemirl", ["row=airl"])["row"] == "pemirl"


@pytest.fixture
def write(here):
    def write(text):
        (here / "mine.yaml").write_text(text, encoding="utf-8")
        return "mine.yaml"

    return write


def test_a_table_may_be_a_file(write):
    file = write(
        "seeds: 2\noverrides: [task=ant]\nrows: {one: {label: One, seeds: 3}, two: {label: Two}}"
    )
    table = read_table(file)
    assert (table.name, table.seeds_of("one"), table.seeds_of("two")) == ("mine", 3, 2)
    config = table.compose("one", ["method=airl"])
    assert (config["table"], config["row"], config["seeds"]) == ("mine", "one", 3)
    assert (config["task"], config["method"]) == ("ant", "airl")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "mine.yaml is no table: expected rows"),
        ("rows: {a: {labell: A}}", r"unknown key mine\.yaml\.rows\.a\.labell"),
        ("rows: {a: {label: A, seeds: 0}}", r"mine\.yaml\.rows\.a\.seeds=0: expected greater than"),
        ("seeds: 3", r"mine\.yaml\.rows is missing"),
    ],
)
def test_a_wrong_file_says_where(write, text, message):
    with pytest.raises(ValueError, match=message):
        read_table(write(text))


def test_an_unknown_table_or_row_lists_those_that_there_are():
    with pytest.raises(ValueError, match="no table 'maze'; choose one of ablations, ant, point_"):
        read_table("maze")
    with pytest.raises(ValueError, match="table ant has no row 'gail'; choose one of meta_il, pem"):
        read_table("ant").seeds_of("gail")
