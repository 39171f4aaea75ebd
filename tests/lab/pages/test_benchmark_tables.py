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
        file.write_text(json.dumps(training(task, peak_memory_mib=500)), encoding="utf-8")
    shown = benchmark_parts(tmp_path, ["training"])["training"]
    assert shown.index("`ant/normal`") < shown.index("`point_maze/left`")
    assert shown.count("meta-training, 2 x 2") == 2
    assert shown.count("collection 75%, policy 25%") == 2


def test_without_files_the_session_that_writes_them_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"lacks .training_<domain>.json.; `nox -s bench` writes"):
        benchmark_parts(tmp_path, ["training"])
