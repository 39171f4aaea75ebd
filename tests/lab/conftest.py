"""Commands inside this process, and once as a user runs them, in a process of its own."""

import importlib
import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig

from pemirl_lab import cli
from pemirl_lab.cli import COMMANDS
from pemirl_lab.runs.composition import compose, plain
from pemirl_lab.runs.settings import parse
from pemirl_lab.runs.tables import read_table

ROOT = Path(__file__).parents[2]
ALONE = os.environ | {"MUJOCO_GL": "disable", "CUDA_VISIBLE_DEVICES": ""}
# Here and not in a test: what MuJoCo's packages log goes to the stream that they found.
OWN = {name: importlib.import_module(f"pemirl_lab.commands.{name}").Own for name in COMMANDS}
QUICKSTART = ("quickstart", "preset=smoke", "threads=1", "run_dir=smoke")


@pytest.fixture(scope="session")
def settings():
    """Settings of a command and its own values, composed and parsed as when it is run."""

    def settings(command, *overrides):
        return parse(plain(compose(command, overrides)), OWN[command])

    return settings


@pytest.fixture(scope="session")
def row_settings():
    """The same of a row of a table."""

    def row_settings(table, row, *overrides):
        return parse(read_table(table).compose(row, overrides), OWN["reproduce"])

    return row_settings


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def command(here, monkeypatch):
    """A command line in this process and an empty working directory."""
    monkeypatch.setattr(sys, "argv", sys.argv)  # what runs a command sets it
    # Hydra sets logging up anew, which closes all handlers; absl's, that dm_control brings, would
    # close pytest's own stream with it.
    monkeypatch.setattr(logging, "shutdown", lambda *handlers: None)
    on_term, handlers = signal.getsignal(signal.SIGTERM), list(logging.root.handlers)
    yield cli.run
    signal.signal(signal.SIGTERM, on_term)
    # Hydra stays as it was when a job leaves it by SystemExit, and logs to this test's stream.
    GlobalHydra.instance().clear()
    HydraConfig.instance().cfg = None
    logging.root.handlers[:] = handlers


@pytest.fixture(scope="session")
def process():
    """``pemirl`` in a process of its own; or other code, by its text."""

    def process(*arguments, cwd, code="from pemirl_lab.cli import main; main()", **environment):
        return subprocess.run(
            [sys.executable, "-c", code, *arguments],
            cwd=cwd,
            capture_output=True,
            text=True,
            env=ALONE | environment,
        )

    return process


@pytest.fixture(scope="session")
def smoke(tmp_path_factory, process):
    """A finished quickstart, run by the user's command: where, and what it printed.

    Its run is ``smoke``, below; it is shared: leave it as it is.
    """
    cwd = tmp_path_factory.mktemp("quickstart")
    done = process(*QUICKSTART, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return cwd, done.stdout + done.stderr
