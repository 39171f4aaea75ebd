"""Pages are what the results files give, and what is written by hand around them stays."""

import fnmatch
import json

import pytest
from omegaconf import OmegaConf

from pemirl_lab.pages import report
from pemirl_lab.results import Result, Score
from pemirl_lab.runs.composition import plain
from pemirl_lab.runs.tables import read_table, table_names

from ..conftest import ROOT

PAGE = """# By hand

<!-- returns:begin -->
old
<!-- returns:end -->

between

<!-- curves:begin -->
<!-- curves:end -->

after
"""
PAGES = """
tables: [maze]
labels: {pemirl: PEMIRL, airl: AIRL}
paper: {one_shot: {airl: [-15.0, 3.0]}}
pages:
  docs/page.md:
    returns:
      - kind: returns
        table: maze
        rows: [airl, pemirl, "context_*"]
        caption: True returns.
        options:
          columns: [{label: left, setting: one_shot, variant: left, paper: "${paper.one_shot}"}]
      - {kind: cost, table: maze, rows: [airl], caption: What AIRL cost.}
    curves:
      - kind: curves
        table: maze
        caption: Learning curve
        options: {file: docs/images/curves.png, stages: {pemirl: train}, variant: left}
      - {kind: provenance, table: maze, rows: ["*"]}
"""
RETURNS = """True returns.

|  | seeds | left | paper |
| --- | --- | --- | --- |
| expert |  | -5.00 | – |
| random |  | -45.00 | – |
| AIRL | – | – | -15.00 ± 3.00 |
| PEMIRL | 1 | -7.00 (0.950) | – |
| context_1 | 1 | -9.00 (0.900) | – |

No results yet: What AIRL cost.

No results yet: AIRL.
"""
CURVES = """![Learning curve](images/curves.png)

2 runs, seeds 0; tasks: test; 2 CPUs (a CPU); torch 2.13.0; torchrl unknown; mujoco unknown; \
commit 0123456789ab-dirty.
"""


def write_result(root, mean, row="pemirl", table="maze"):
    score = Score(
        setting="one_shot",
        variant="left",
        goals="all",
        per_task=(mean,),
        random=-45.0,
        expert=-5.0,
        env_steps={"meta_training": 10, "adaptation": 0},
    )
    Result(
        table=table, row=row, task="maze", seed=0, split="test", scores=(score,),
        curves={"train": [[0, -40.0], [10, mean]]}, seconds={}, config={},
        versions={"torch": "2.13.0"}, hardware={"cpus": 2, "cpu": "a CPU"},
        commit="0123456789abcdef-dirty",
    ).write(root / "results/maze" / row / "seed0.json")  # fmt: skip


@pytest.fixture
def root(tmp_path):
    """A small repository: results, a specification, a page."""
    for name, text in (("docs/pages.yaml", PAGES), ("docs/page.md", PAGE)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    write_result(tmp_path, -7.0)
    write_result(tmp_path, -9.0, row="context_1")
    return tmp_path


@pytest.fixture
def command(root):
    return lambda *arguments: report.main(["--root", str(root), *arguments])


def test_pages_are_written_between_their_markers(command, root, capsys):
    command("--write")
    text = (root / "docs/page.md").read_text(encoding="utf-8")
    begin, end = PAGE.split("old\n")
    assert text == begin + RETURNS + end.replace("in -->\n", f"in -->\n{CURVES}")
    assert (root / "docs/images/curves.png").read_bytes()[1:4] == b"PNG"
    command("--check")
    command("--write")
    assert (root / "docs/page.md").read_text(encoding="utf-8") == text
    capsys.readouterr()
    command()
    assert capsys.readouterr().out == (
        f"--- docs/page.md: returns\n{RETURNS}\n--- docs/page.md: curves\n{CURVES}\n"
    )


@pytest.mark.parametrize(
    ("old", "new"), [("-7.00", "-6.00"), ("-15.00 ±", "-14.00 ±"), ("No results yet: AIRL.\n", "")]
)
def test_a_changed_page_fails_the_check(command, root, old, new):
    command("--write")
    page = root / "docs/page.md"
    text = page.read_text(encoding="utf-8")
    assert text.count(old) == 1
    page.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(SystemExit, match=r"page\.md is not what the results files give"):
        command("--check")


def test_a_changed_result_or_a_lost_figure_fails_the_check(command, root):
    command("--write")
    (root / "docs/images/curves.png").unlink()
    with pytest.raises(SystemExit, match=r"curves\.png is missing"):
        command("--check")
    command("--write")
    write_result(root, -8.0)
    with pytest.raises(SystemExit, match=r"page\.md is not what"):
        command("--check")


def test_text_by_hand_is_not_checked(command, root):
    command("--write")
    page = root / "docs/page.md"
    text = page.read_text(encoding="utf-8").replace("between", "something else")
    page.write_text(text, encoding="utf-8")
    command("--check")
    command("--write")
    assert page.read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "kind: cost",
            "kind: price",
            "docs/page.md, part 'returns': kind is 'price', expected one",
        ),
        ("table: maze", "table: ant", "table is 'ant', expected one of maze"),
        (
            "variant: left, paper",
            "dynamics: left, paper",
            "part 'returns': variant is missing; unknown key dynamics",
        ),
        ("caption: True", "title: True", "part 'returns': unknown key title"),
        ("variant: left}", "variant: left, colour: red}", "unexpected keyword argument 'colour'"),
        (
            "    returns:",
            "    scores:",
            "has markers of .*'returns'.*expected, each once, .*'scores'",
        ),
    ],
)
def test_a_wrong_specification_says_where(command, root, old, new, message):
    file = root / "docs/pages.yaml"
    assert old in file.read_text(encoding="utf-8")
    file.write_text(PAGES.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        command("--write")


def test_benchmarks_are_tables_of_their_files(command, root):
    pages = root / "docs/pages.yaml"
    pages.write_text(f"{PAGES}\nbenchmarks: {{docs/page.md: [stepping]}}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"page\.md has markers of .*; expected, .*'stepping'"):
        command("--write")
    page = root / "docs/page.md"
    page.write_text(f"{PAGE}<!-- stepping:begin -->\n<!-- stepping:end -->\n", encoding="utf-8")
    ratios = {"environment": 0.85, "environment + policy": 0.7, "collector": 0.654}
    measured = {
        "task": "maze/left", "num_envs": 64, "repetitions": 3, "cpus": 2,
        "steps_per_second": {"raw engine": 12345}, "ratio_to_raw_engine": ratios,
        "versions": {"mujoco": "3.17.0", "torch": "2.13.0"},
    }  # fmt: skip
    (root / "results/benchmarks").mkdir(parents=True)
    (root / "results/benchmarks/stepping_maze.json").write_text(json.dumps(measured))
    command("--write")
    text = page.read_text(encoding="utf-8")
    assert "| `maze/left` | 64 | 12,345 | 85% | 70% | 65% |\n" in text
    assert "2 CPUs; mujoco 3.17.0; torch 2.13.0; repetitions: maze/left: 3.\n" in text
    pages.write_text(f"{PAGES}\nbenchmarks: {{docs/page.md: [training]}}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"lacks 'training_<domain>\.json'; `nox -s bench` writes"):
        command("--write")
    pages.write_text(f"{PAGES}\nbenchmarks: {{docs/page.md: [speed]}}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"benchmark tables \['speed'\]; expected some of"):
        command("--write")


def test_results_of_another_table_are_refused(command, root):
    write_result(root, -7.0, row="stray", table="ant")
    with pytest.raises(ValueError, match=r"results/maze holds results of tables \['ant', 'maze'\]"):
        command()


def test_a_folder_without_pages_is_no_checkout(tmp_path, capsys):
    with pytest.raises(SystemExit):
        report.main(["--root", str(tmp_path), "--check"])
    assert (
        f"{tmp_path} is no checkout of the repository: it has no docs/" in capsys.readouterr().err
    )


def test_rows_are_called_as_their_tables_say():
    labels = report.row_labels()
    for table in map(read_table, table_names()):
        for name, row in table.rows.items():
            assert labels[name] == row.label, f"{table.name}: a label of {name} differs"


def test_every_row_of_every_table_is_on_a_page():
    """A row that was run and shown nowhere would be a result that is hidden."""
    values = plain(OmegaConf.load(ROOT / "docs/pages.yaml"))
    items = [item for parts in values["pages"].values() for part in parts.values() for item in part]
    assert set(table_names()) <= set(values["tables"])
    for table in table_names():
        shown = {
            row
            for item in items
            if (item["table"], item["kind"]) == (table, "returns")
            for row in item["rows"]
        }
        hidden = [
            row
            for row in read_table(table).rows
            if not any(fnmatch.fnmatch(row, pattern) for pattern in shown)
        ]
        assert hidden == [], table
