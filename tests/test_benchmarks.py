"""The benchmarks run, on every domain, and say what they measured."""

import argparse
import importlib
import json
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
DOMAINS = (
    "point_maze/left",
    pytest.param("ant/normal", marks=pytest.mark.long),
    pytest.param("sweeper/normal", marks=pytest.mark.long),
    "sawyer_pusher/normal",
)


@pytest.fixture
def training(monkeypatch):
    """``benchmarks/training.py``, on few rollouts and without processes of its own."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    monkeypatch.setitem(sys.modules, "trainings", importlib.import_module("trainings"))
    trainings, training = sys.modules["trainings"], importlib.import_module("training")
    monkeypatch.setattr(trainings, "CONTEXTS", 2)
    monkeypatch.setattr(trainings, "DEMONSTRATIONS", 3)
    monkeypatch.setattr(trainings, "TASKS", 2)
    few = (
        trainings.Setting("meta-training", 2, 2, trainings.meta_training),
        trainings.Setting("adaptation", 2, 3, trainings.adaptation),
    )
    monkeypatch.setattr(training, "SETTINGS", few)
    monkeypatch.setattr(training, "peak_memory_alone", trainings.peak_memory)
    yield training
    for name in ("trainings", "training"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("task", DOMAINS)
def test_training_is_measured_on_every_domain(training, task):
    given = argparse.Namespace(task=task, method="pemirl_contrastive", num_threads=1, repetitions=1)
    report = training.report(given)
    json.dumps(report)
    rows = report["results"]
    assert list(rows) == [
        "raw engine, 4", "meta-training, 2 x 2", "raw engine, 6", "adaptation, 2 x 3"
    ]  # fmt: skip
    for name, row in rows.items():
        assert row["steps_per_second"] > 0
        if not name.startswith("raw"):
            assert 0 < row["ratio_to_raw_engine"] < 1
            assert sum(row["share_of_time"].values()) == pytest.approx(1, abs=0.01)
            assert row["seconds_per_iteration"] > 0
            assert row["cpu_us_per_step"] > 0
            assert row["peak_memory_mib"] > 50
    assert all(name in training.table(rows) for name in rows)
