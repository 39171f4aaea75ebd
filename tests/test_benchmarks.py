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
    monkeypatch.setattr(trainings, "DEMONSTRATIONS", 3)
    few = (
        trainings.Setting("meta-training", 2, 2, trainings.meta_training),
        trainings.Setting("adaptation", 2, 3, trainings.adaptation),
    )
    monkeypatch.setattr(training, "SETTINGS", few)
    monkeypatch.setattr(training, "peak_memory_alone", trainings.peak_memory)
    yield training
    for name in ("trainings", "training", "growth"):
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
        assert row["cpu_us_per_step"] > 0
        if not name.startswith("raw"):
            assert 0 < row["ratio_to_raw_engine"] < 1
            assert sum(row["share_of_time"].values()) == pytest.approx(1, abs=0.01)
            assert row["seconds_per_iteration"] > 0
            assert 0 < row["ratio_of_cpu_time"] < 1
            assert row["peak_memory_mib"] > 50
    assert all(name in training.table(rows) for name in rows)


def test_growth_is_measured_in_each_direction(training, monkeypatch):
    growth = importlib.import_module("growth")

    class Here:
        """An executor that computes in this process."""

        def __init__(self, *_args, **_options): ...

        def __enter__(self):
            return self

        def __exit__(self, *_error): ...

        def submit(self, function, *given):
            return argparse.Namespace(result=lambda: function(*given))

    base = growth.Setting("meta-training", 2, 2, growth.meta_training, horizon=5)
    few = {"base": base, "horizon": growth.replace(base, horizon=10)}
    monkeypatch.setattr(growth, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(growth, "settings", lambda _: few)
    report = growth.report("point_maze/left", "pemirl", 1, 1)
    json.dumps(report)
    assert [row["horizon"] for row in report["results"].values()] == [5, 10]
    assert report["results"]["base"]["cpu_ratio"] == report["results"]["base"]["memory_ratio"] == 1
    assert all(row["cpu_seconds"] > 0 for row in report["results"].values())


def test_growth_doubles_one_thing_at_a_time(training):
    base, *others = importlib.import_module("growth").settings(100).values()
    sizes = [(s.contexts, s.rollouts, s.horizon) for s in (base, *others)]
    doubled = [[b / a for a, b in zip(sizes[0], size, strict=True)] for size in sizes[1:]]
    assert doubled == [[2, 1, 1], [1, 2, 1], [1, 1, 2]]


def test_settings_of_several_torch_threads_have_rows_of_their_own(training):
    everything = importlib.import_module("trainings").SETTINGS
    assert len({setting.title for setting in everything}) == len(everything)
    assert any(setting.title.endswith(", 2 torch threads") for setting in everything)
