"""Results on tasks that are not this project's own, as a table."""

import json

import pytest

from pemirl_lab.pages.own_tasks import own_task_parts


def test_every_seed_and_their_mean(tmp_path):
    (tmp_path / "pole").mkdir()
    for seed, gap in enumerate((0.9, 1.0, 0.8)):
        means = {"adapted": -10.0 - seed, "carried_over": -100.0, "rl_with_true_reward": -9.0}
        run = {
            "seed": seed,
            "gap_closed": gap,
            "means": {**means, "expert": -8.0, "random": -200.0},
            "seconds": {"meta_training": 90.0, "adaptation": 30.0, "experts": 600.0},
        }
        (tmp_path / f"pole/seed{seed}.json").write_text(json.dumps(run))
        if seed == 0:  # has no interval
            assert len(own_task_parts(tmp_path, ["pole"])["pole"].splitlines()) == 3
    lines = own_task_parts(tmp_path, ["pole"])["pole"].splitlines()
    assert lines[2] == "| 0 | 0.900 | -10.0 | -100.0 | -9.0 | -8.0 | -200.0 | 2.0 |"
    assert lines[-1] == (  # Student's t of three
        "| mean | 0.900 [0.652, 1.148] | -11.0 | -100.0 | -9.0 | -8.0 | -200.0 |  |"
    )


def test_the_terms_of_a_return_are_a_table_of_their_own(tmp_path):
    (tmp_path / "arm").mkdir()
    returns = {
        "adapted": -6.0,
        "carried_over": -12.0,
        "rl_with_true_reward": -4.0,
        "expert": -3.0,
        "random": -20.0,
    }
    distance = {**returns, "adapted": -3.0, "rl_with_true_reward": -3.0}
    seconds = {"meta_training": 90.0, "adaptation": 30.0}
    run = {"seed": 0, "gap_closed": 0.75, "means": returns, "seconds": seconds}
    run["terms"] = {"distance": distance}
    (tmp_path / "arm/seed0.json").write_text(json.dumps(run))
    table, terms = own_task_parts(tmp_path, ["arm"])["arm"].split("\n\n")
    assert table.splitlines()[2] == "| 0 | 0.750 | -6.0 | -12.0 | -4.0 | -3.0 | -20.0 | 2.0 |"
    assert terms.splitlines()[2] == "| distance | 1.000 | -3.0 | -12.0 | -3.0 | -3.0 | -20.0 |"


def test_a_task_without_results_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"pole holds no results seed\*\.json"):
        own_task_parts(tmp_path, ["pole"])
