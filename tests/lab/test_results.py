"""A result that contradicts itself is refused, and files say where they are wrong."""

import json
import subprocess

import pytest

from pemirl_lab import results as module
from pemirl_lab.results import (
    Result,
    Score,
    environment_facts,
    normalised_return,
    read,
    read_all,
)


def score_fields(**changed):
    return {
        "variant": "left",
        "setting": "one_shot",
        "goals": "all",
        "per_task": [-6.0, -8.0],
        "random": -47.0,
        "expert": -5.0,
        "env_steps": {"meta_training": 1000, "adaptation": 0},
    } | changed


def fields(**changed):
    return {
        "table": "point_maze",
        "row": "pemirl",
        "task": "point_maze",
        "seed": 0,
        "split": "test",
        "scores": (Score(**score_fields()), Score(**score_fields(variant="right"))),
        "reward": {"r/map/spearman/mean": 0.9},
        "curves": {"pemirl": [[100, -40.0], [200, -7.5]]},
        "seconds": {"pemirl": 3.5},
        "config": {"seed": 0, "nested": {"list": [1, 2.5, None]}},
        "versions": {"torch": "2.13.0"},
        "hardware": {"cpus": 2},
        "commit": "abc",
    } | changed


def test_normalised_return():
    assert normalised_return(-47, -47, -5) == 0
    assert normalised_return(-5, -47, -5) == 1
    assert normalised_return(-26, -47, -5) == 0.5
    with pytest.raises(ValueError, match="not above the random"):
        normalised_return(0, 1, 1)


def test_a_score_fills_in_what_follows_from_the_rest():
    score = Score(**score_fields())
    assert score.mean == -7
    assert score.normalised == pytest.approx(40 / 42)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"setting": "zero_shot"}, "'zero_shot', expected one of one_shot, policy_generalisation"),
        ({"per_task": []}, "expected finite numbers and a task"),
        ({"per_task": [-6.0, float("nan")]}, "expected finite numbers"),
        ({"random": float("-inf")}, "expected finite numbers"),
        ({"mean": -7.5}, "mean is -7.5, but the other fields give -7.0"),
        ({"normalised": 0.9}, "normalised is 0.9, but"),
        ({"expert": -50.0}, "not above the random return"),
        ({"env_steps": {"training": 1}}, r"\['training'\], expected \['adaptation', 'meta_tr"),
    ],
)
def test_a_score_that_is_wrong_says_where(changed, message):
    with pytest.raises(ValueError, match=message):
        Score(**score_fields(**changed))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"schema": 1}, "schema is 1, this version reads 2"),
        ({"seed": "0"}, "seed is '0', expected an integer"),
        ({"seed": True}, "seed is True, expected an integer"),
        ({"row": 3, "split": None}, "row is 3, expected a string; split is None, expected a"),
        ({"scores": ()}, "expected at least one"),
        ({"scores": (Score(**score_fields()),) * 2}, "and each once"),
        ({"reward": {"epic": float("nan")}}, "expected finite numbers"),
    ],
)
def test_a_result_that_is_wrong_says_where(changed, message):
    with pytest.raises(ValueError, match=message):
        Result(**fields(**changed))


def test_scores_are_found_by_what_was_measured():
    result = Result(**fields())
    assert result.score("one_shot", "right") is result.scores[1]
    assert result.score("one_shot", "right", "x_in_0.1_0.4") is None


def test_file_round_trip(tmp_path):
    result = Result(**fields())
    result.write(tmp_path / "pemirl" / "seed0.json")
    assert read(tmp_path / "pemirl" / "seed0.json") == result
    content = json.loads((tmp_path / "pemirl" / "seed0.json").read_text())
    assert list(content) == [*fields(), "schema"]
    Result(**fields(row="airl")).write(tmp_path / "airl" / "seed0.json")
    assert [found.row for found in read_all(tmp_path)] == ["airl", "pemirl"]


def test_reading_names_the_file_and_the_fields(tmp_path):
    path = tmp_path / "a.json"
    Result(**fields()).write(path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps({k: v for k, v in content.items() if k != "seed"} | {"extra": 1}))
    with pytest.raises(ValueError, match=r"a\.json: missing fields \['seed'\], unknown .*'extra'"):
        read(path)
    content["scores"][0]["normalised"] = 0.1
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"a\.json: not a valid score: normalised"):
        read(path)
    for text in ("{", "[1]"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"a\.json: "):
            read(path)


def test_facts_are_json_and_know_the_packages():
    facts = environment_facts()
    assert json.loads(json.dumps(facts)) == facts
    assert {"python", "torch", "torchrl", "tensordict"} <= set(facts["versions"])
    assert facts["hardware"]["cpu"]
    assert facts["hardware"]["cpus"] >= 1


def test_commit_says_whether_files_had_changed(tmp_path, monkeypatch):
    source = tmp_path / "results.py"
    monkeypatch.setattr(module, "__file__", str(source))

    def git(*arguments):
        identity = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
        command = ["git", "-C", str(tmp_path), *identity, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    git("init", "-q")
    source.write_text("1")
    assert environment_facts()["commit"] == "unknown"  # in a repository that does not track it
    git("add", ".")
    git("commit", "-q", "-m", "one")
    assert environment_facts()["commit"] == git("rev-parse", "HEAD")
    source.write_text("2")
    assert environment_facts()["commit"] == git("rev-parse", "HEAD") + "-dirty"
