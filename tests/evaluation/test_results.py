"""A result that contradicts itself is refused, and tables show what the results say."""

import json
import subprocess

import pytest

from pemirl_trl.evaluation import results as module
from pemirl_trl.evaluation.results import (
    Result,
    environment_facts,
    normalised_return,
    read,
    table,
)


def fields(**changed):
    return {
        "task": "point_maze",
        "variant": "left",
        "method": "pemirl",
        "setting": "one_shot",
        "seed": 0,
        "goals": "all",
        "returns": {"mean": -7.0, "per_task": [-6.0, -8.0]},
        "random": -47.0,
        "expert": -5.0,
        "normalised": 40 / 42,
        "env_steps": {"meta_training": 1000, "adaptation": 0},
        "seconds": {"meta_training": 3.5},
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


def test_file_round_trip(tmp_path):
    result = Result(**fields())
    result.write(tmp_path / "runs" / "a.json")
    assert read(tmp_path / "runs" / "a.json") == result
    assert list(json.loads((tmp_path / "runs" / "a.json").read_text())) == [*fields(), "schema"]


def test_measured_fills_in_what_follows_from_the_rest():
    derived = ("returns", "normalised", "versions", "hardware", "commit", "random", "expert")
    known = {name: value for name, value in fields().items() if name not in derived}
    result = Result.measured(per_task=[-6, -8], random=-47, expert=-5, **known)
    assert result.returns == fields()["returns"]
    assert result.normalised == pytest.approx(fields()["normalised"])
    assert result.versions["torch"]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"setting": "zero_shot"}, "'zero_shot', expected one of one_shot, policy_generalisation"),
        ({"schema": 2}, "schema is 2, this version reads 1"),
        ({"seed": "0"}, "seed is '0', expected int"),
        ({"seed": True}, "seed is True, expected int"),
        ({"task": 3, "config": []}, r"task is 3, expected str; config is \[\], expected mapping"),
        ({"random": None}, "random is None, expected float"),
        ({"returns": {"mean": -7.0}}, "expected mean and a non-empty per_task"),
        ({"returns": {"mean": 0.0, "per_task": []}}, "non-empty per_task"),
        ({"returns": {"mean": -7.5, "per_task": [-6.0, -8.0]}}, "mean is -7.5, but .* give -7.0"),
        ({"returns": {"mean": -7.0, "per_task": [-6.0, float("nan")]}}, "finite"),
        ({"normalised": 0.9}, "normalised is 0.9, but"),
        ({"expert": -50.0}, "not above the random return"),
        ({"env_steps": {"training": 1}}, r"\['training'\], expected \['adaptation', 'meta_tr"),
    ],
)
def test_a_result_that_is_wrong_says_where(changed, message):
    with pytest.raises(ValueError, match=message):
        Result(**fields(**changed))


def test_reading_names_the_file_and_the_fields(tmp_path):
    path = tmp_path / "a.json"
    content = fields(extra=1, schema=1)
    del content["seed"]
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"a\.json: missing fields \['seed'\], unknown .*'extra'"):
        read(path)
    path.write_text(json.dumps(fields(schema=1, normalised=0.1)))
    with pytest.raises(ValueError, match=r"a\.json: not a valid result: normalised"):
        read(path)
    for text in ("{", "[1]"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"a\.json: "):
            read(path)


def with_mean(mean, **changed):
    values = {"returns": {"mean": mean, "per_task": [mean]}, "normalised": (mean + 47) / 42}
    return Result(**fields(**values, **changed))


def test_table_shows_means_and_every_seed():
    text = table(
        [
            with_mean(-9.0, seed=1),
            with_mean(-5.0, seed=0),
            with_mean(-26.0, method="airl"),
            with_mean(-30.0, variant="right", setting="reward_adaptation", method="airl"),
        ]
    )
    assert text.splitlines() == [
        "| task | setting | goals | random | expert | airl | pemirl |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| point_maze left | one_shot | all | -47.00 | -5.00 | -26.00 (0.500) [-26.00]"
        " | -7.00 (0.952) [-5.00, -9.00] |",
        "| point_maze right | reward_adaptation | all | -47.00 | -5.00"
        " | -30.00 (0.405) [-30.00] | – |",
    ]


def test_table_refuses_a_seed_counted_twice():
    with pytest.raises(ValueError, match=r"two results for pemirl, .*, seed 0"):
        table([with_mean(-9.0), with_mean(-8.0)])
    with pytest.raises(ValueError, match="no results"):
        table([])


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
