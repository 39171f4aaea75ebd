"""A published run beside the same one made again."""

from dataclasses import replace

import pytest

from pemirl_lab.pages.rounding import rounding_table
from pemirl_lab.results import Result, Score


@pytest.fixture
def results(tmp_path):
    """Two stored seeds, and seed 1 made again: one return differs by a little."""

    def result(seed, value):
        score = Score(
            variant="left",
            setting="one_shot",
            goals="all",
            per_task=(value, value),
            random=-50.0,
            expert=-5.0,
            env_steps={"meta_training": 1, "adaptation": 0},
        )
        facts = {"versions": {}, "hardware": {"cpu": f"kind {seed}"}, "commit": "c", "config": {}}
        names = {"table": "maze", "row": "pemirl", "task": "maze", "split": "test"}
        return Result(**names, seed=seed, scores=(score,), seconds={}, **facts)

    result(0, -8.0).write(tmp_path / "maze/pemirl/seed0.json")
    result(1, -6.0).write(tmp_path / "maze/pemirl/seed1.json")
    again = replace(result(1, -6.125), hardware={"cpu": "kind 9"})
    again.write(tmp_path / "benchmarks/rounding_maze.json")
    return tmp_path


def test_each_score_stands_beside_its_stored_one(results):
    table = rounding_table(results, "maze").splitlines()
    assert table[0] == "| true return | stored | again | stored, all 2 seeds |"
    assert table[2] == "| one-shot, left | -6.000 | -6.125 | -8.00 to -6.00 |"
    assert table[-1] == "Stored: kind 1; again: kind 9."
