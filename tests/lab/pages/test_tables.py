"""Tables show what the results say; every number is worked out by hand."""

import pytest

from pemirl_lab.pages.convergence import Stage, convergence_table, steps_to_converge
from pemirl_lab.pages.tables import (
    Column,
    cost_table,
    improvement_table,
    markdown_table,
    parse_markdown_table,
    returns_table,
    reward_table,
    seeds_table,
)
from pemirl_lab.results import Result, Score

ADAPTATION = Column(setting="reward_adaptation", variant="right", label="adaptation")
ONE_SHOT = Column(setting="one_shot", variant="left", label="one-shot")
CONSTANT = [-7.0] * 4  # a bootstrap of it is certain


def score(mean, column=ADAPTATION, steps=2_000_000, **changed):
    values = {"random": -45.0, "expert": -5.0} | changed
    return Score(
        setting=column.setting,
        variant=column.variant,
        goals=column.goals,
        per_task=(mean,),
        env_steps={"meta_training": 4_000_000, "adaptation": steps},
        **values,
    )


def result(mean=-7.0, *, row="pemirl", seed=0, scores=None, **changed):
    values = {
        "table": "point_maze",
        "task": "point_maze",
        "split": "test",
        "seconds": {"meta_training": 60.0},
        "config": {},
        "versions": {},
        "hardware": {},
        "commit": "abc",
    } | changed
    return Result(row=row, seed=seed, scores=tuple(scores or [score(mean)]), **values)


def results(means, **same):
    return [result(mean, seed=seed, **same) for seed, mean in enumerate(means)]


def test_a_cell_of_few_seeds_is_their_mean_with_students_interval():
    text = returns_table(results([-25.0, -9.0, -5.0, -4.0]), [ADAPTATION])
    # Deviation 9.74 of four: 3.18 x 9.74 / 2 to either side; 34.25 of 40 normalised.
    assert text.splitlines()[-1] == "| pemirl | 4 | -10.75 [-26.25, 4.75] (0.856) |"


def test_a_cell_of_ten_seeds_is_the_interquartile_mean_with_a_bootstrapped_interval():
    means = [-95.0, -25.0, -9.0, -8.0, -7.0, -7.0, -6.0, -5.0, -4.0, -3.0]
    row = returns_table(results(means), [ADAPTATION]).splitlines()[-1]
    assert row.startswith("| pemirl | 10 | -7.00 [")  # without the two lowest and the two highest
    low, high = map(float, row.split("[")[1].split("]")[0].split(", "))
    assert -60 < low < -7 < high <= -4


def test_rows_columns_references_and_the_paper():
    paper = {"expert": (-5.2, 0.9), "random": (-55.2, 9.0), "airl": (-15.2, 3.0), "gone": (-1, 0)}
    column = Column(setting="reward_adaptation", variant="right", paper=paper)
    found = [*results(CONSTANT), result(-25.0, row="airl")]
    unmeasured = Column(setting="reward_adaptation", variant="left")
    rows = {"airl": "AIRL", "pemirl": "PEMIRL", "gone": "Gone", "other": "Other"}
    assert returns_table(found, [column, ONE_SHOT, unmeasured], rows).splitlines() == [
        "|  | seeds | reward adaptation, right, goals: all | paper |",
        "| --- | --- | --- | --- |",
        "| expert |  | -5.00 | -5.20 ± 0.90 |",
        "| random |  | -45.00 | -55.20 ± 9.00 |",
        "| AIRL | 1 | -25.00 (0.500) | -15.20 ± 3.00 (0.800) |",
        "| PEMIRL | 4 | -7.00 [-7.00, -7.00] (0.950) | – |",
        "| Gone | – | – | -1.00 ± 0.00 (1.084) |",
    ]


def test_by_default_everything_measured_is_shown_and_missing_cells_are_dashes():
    both = result(scores=[score(-7.0), score(-9.0, ONE_SHOT)])
    lines = returns_table([both, result(-25.0, row="airl")]).splitlines()
    assert lines[0] == (
        "|  | seeds | reward adaptation, right, goals: all | one shot, left, goals: all |"
    )
    assert lines[-2:] == [
        "| airl | 1 | -25.00 (0.500) | – |",
        "| pemirl | 1 | -7.00 (0.950) | -9.00 (0.900) |",
    ]


def test_a_cell_of_fewer_seeds_and_references_that_differ_say_so():
    found = [result(), result(seed=1, scores=[score(-9.0, ONE_SHOT)])]
    assert "| pemirl | 2 | -7.00 (0.950, 1 of 2 seeds) |" in returns_table(found, [ADAPTATION])
    found = [result(), result(seed=1, scores=[score(-7.0, expert=-4.0)])]
    assert "| expert |  | -5.00 to -4.00 |" in returns_table(found, [ADAPTATION])


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({}, "two results for row 'pemirl', seed 0"),
        ({"seed": 1, "split": "validation"}, r"\('point_maze', 'test'\), .*'validation'"),
        ({"seed": 1, "table": "ablations"}, "'ablations'.*expected those of one"),
    ],
)
def test_runs_that_do_not_belong_together_are_refused(second, message):
    with pytest.raises(ValueError, match=message):
        returns_table([result(), result(**second)])


def test_every_seed_and_the_worst():
    found = [*results([-7.0, -31.0, -6.0]), result(-8.0, row="airl", seed=1)]
    rows = {"pemirl": "PEMIRL", "airl": "AIRL", "other": "Other"}
    assert seeds_table(found, [ADAPTATION, ONE_SHOT], rows).splitlines() == [
        "|  | measured | worst | seed 0 | seed 1 | seed 2 |",
        "| --- | --- | --- | --- | --- | --- |",
        "| PEMIRL | adaptation | -31.00 | -7.00 | -31.00 | -6.00 |",
        "| AIRL | adaptation | -8.00 | – | -8.00 | – |",
    ]


def test_improvement_is_paired_by_seed():
    base = results([-10.0, -20.0, -30.0])
    shifted = results([-9.0, -19.0, -29.0], row="robust")  # +1 on each seed, 6 of 9 pairs
    alone = [result(-5.0, row="alone", seed=7)]
    rows = {"pemirl": "PEMIRL", "robust": "robust", "alone": "alone", "other": "other"}
    lines = improvement_table(base + shifted + alone, ADAPTATION, "pemirl", rows).splitlines()
    assert lines[0] == (
        "| adaptation | P(better than PEMIRL) | difference by seed | better on seeds |"
    )
    assert lines[2].startswith("| robust | 0.67 [")
    assert lines[2].endswith("] | 1.00 [1.00, 1.00] | 3 of 3 |")
    assert lines[3] == "| alone | 1.00 | – | – |"
    assert len(lines) == 4
    with pytest.raises(ValueError, match="baseline is 'gail', expected one of pemirl, robust"):
        improvement_table(base, ADAPTATION, "gail", rows)


def test_reward_measures():
    found = [result(seed=seed, reward={"a": 0.5, "other": 9.0}) for seed in range(3)]
    found.append(result(row="meta_il"))
    rows = {"meta_il": "Meta-IL", "pemirl": "PEMIRL"}
    assert reward_table(found, {"a": "A", "b": "B"}, rows).splitlines()[2:] == [
        "| PEMIRL | 3 | 0.500 [0.500, 0.500] | – |"
    ]


def test_cost_is_the_median_over_seeds():
    found = [
        result(seed=seed, scores=[score(-7.0), score(-9.0, ONE_SHOT, steps=0)], seconds=seconds)
        for seed, seconds in enumerate([{"a": 30.0, "b": 30.0}, {"a": 600.0}, {"a": 120.0}])
    ]
    assert cost_table(found, {"pemirl": "PEMIRL"}).splitlines()[2:] == [
        "| PEMIRL | 3 | 4.00M | 2.00M | 2.0 (1.0 to 10.0) |"
    ]


@pytest.mark.parametrize(
    ("curve", "steps"),
    [
        ([(1, -40.0), (2, -6.0), (3, -5.0)], 2),  # the threshold is -45 + 0.95 * 40 = -7
        ([(1, -6.0), (2, -8.0), (3, -7.0), (4, -6.0)], 3),  # it fell back once
        ([(1, -5.0), (2, -7.1)], None),
        ([(1, -5.0)], 1),
        ([], None),
    ],
)
def test_steps_to_converge(curve, steps):
    assert steps_to_converge(curve, expert=-5.0, random=-45.0) == steps


def test_a_seed_that_never_converges_is_the_slowest():
    curves = ([[1e6, -40.0], [2e6, -6.0]], [[1e6, -6.0], [2e6, -6.0]], [[1e6, -40.0]])
    found = [result(seed=seed, curves={"a": curve}) for seed, curve in enumerate(curves)]
    stage = Stage(row="pemirl", stage="a", variant="right", label="learned", paper=5.4e6)
    absent = Stage(row="pemirl", stage="b", variant="right", label="absent")
    assert convergence_table(found, [stage, absent]).splitlines()[2:] == [
        "| learned | 2.00M | 2 of 3 | 2.00M, 1.00M, never | 5.40M |"
    ]
    assert "| learned | never | 0 of 1 |" in convergence_table(found[2:], [stage])
    lost = Stage(row="pemirl", stage="a", variant="left", label="learned")
    with pytest.raises(ValueError, match=r"no score of all goals under 'left'.*'right', 'all'"):
        convergence_table(found, [lost])


def test_tables_without_results_are_empty():
    rows = {"gone": "Gone"}
    column = Column(setting="reward_adaptation", variant="right", paper={"gone": (-1.0, 0.5)})
    found = [result()]
    assert returns_table(found, [column], rows) == ""
    assert seeds_table(found, [column], rows) == ""
    assert improvement_table(found, column, "gone", rows) == ""
    assert reward_table(found, {"a": "A"}, {"pemirl": "PEMIRL"}) == ""
    assert cost_table([], rows) == ""
    assert returns_table([]) == ""


def test_a_cell_may_hold_a_bar():
    table = [["sign", "measured"], ["r exploding", "mean |r|, in nats"], ["", "a | b"]]
    text = markdown_table(table[0], table[1:])
    assert text.splitlines()[2] == r"| r exploding | mean \|r\|, in nats |"
    assert parse_markdown_table(text) == table
    assert parse_markdown_table("a line of text\n") == []
