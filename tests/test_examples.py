"""The examples run as their first lines say, and do what they promise."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

# A user's trainer need not silence TorchRL's.
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning")


@pytest.fixture
def example(monkeypatch):
    """Imports an example by its name, from a clone."""
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    return importlib.import_module


def test_a_loop_of_ones_own_moves_the_policy_at_every_step(example):
    steps = list(example("compose_your_own_loop").meta_train(2, 4, 2))
    assert [step.accepted for step in steps] == [True, True]


def test_a_task_of_ones_own_is_solved_under_changed_dynamics(example):
    returns = example("own_task").main(0.5)
    assert returns["adapted"] > returns["random"] > returns["carried over"]


def test_an_example_runs_as_a_script():
    command = [sys.executable, "examples/compose_your_own_loop.py", "1", "2", "2"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("TrustRegionResult(")


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_an_example_fits_on_a_page(file):
    assert len(file.read_text("utf-8").splitlines()) < 60
