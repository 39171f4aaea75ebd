"""Tables of the benchmarks' files."""

import json

import pytest

from pemirl_lab.pages.benchmark_tables import benchmark_parts


def training(task, **row):
    return {
        "task": task,
        "repetitions": 3,
        "cpus": 2,
        "versions": {"mujoco": "1", "torch": "2"},
        "results": {
            "raw engine, 4": {"steps_per_second": 1000},
            "meta-training, 2 x 2": {
                "steps_per_second": 500,
                "ratio_to_raw_engine": 0.5,
                "share_of_time": {"policy": 0.25, "collection": 0.75},
                **row,
            },
        },
    }


def test_training_has_a_table_for_each_domain(tmp_path):
    for name, task in (("point_maze", "point_maze/left"), ("ant", "ant/normal")):
        file = tmp_path / f"training_{name}.json"
        file.write_text(json.dumps(training(task, ratio_of_cpu_time=0.6)), encoding="utf-8")
    shown = benchmark_parts(tmp_path, ["training"])["training"]
    assert shown.index("`ant/normal`") < shown.index("`point_maze/left`")
    assert shown.count("meta-training, 2 x 2") == 2
    assert shown.count("| 500 | 50% | 60% | collection 75%, policy 25% |") == 2


def test_growth_is_told_beside_its_base(tmp_path):
    base = {"contexts": 2, "rollouts": 3, "horizon": 4, "cpu_seconds": 0.5, "cpu_ratio": 1.0}
    base |= {"peak_memory_mib": 400, "memory_ratio": 1.0}
    doubled = base | {"contexts": 4, "cpu_seconds": 0.8, "cpu_ratio": 1.6}
    rows = {"base": base, "contexts": doubled}
    file = training("ant/normal") | {"load": 1.5, "results": rows}
    (tmp_path / "growth_ant.json").write_text(json.dumps(file), encoding="utf-8")
    shown = benchmark_parts(tmp_path, ["growth"])["growth"]
    assert "| `ant/normal` | 2 | 3 | 4 | 0.50 (1.00) | 400 (1.00) |" in shown
    assert "| twice the contexts | 4 | 3 | 4 | 0.80 (1.60) | 400 (1.00) |" in shown
    assert "load of the machine: ant/normal: 1.5" in shown


def test_without_files_the_session_that_writes_them_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"lacks .training_<domain>.json.; `nox -s bench` writes"):
        benchmark_parts(tmp_path, ["training"])
