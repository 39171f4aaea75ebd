"""From the words of a command line to a run.

A command is a module of :mod:`pemirl_lab.commands` with a YAML file of its name in ``conf/``: its
``Own`` says what values it has besides :class:`~pemirl_lab.runs.settings.Settings`, its ``run``
does it.
"""

from __future__ import annotations

import importlib
import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NoReturn

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from pemirl_lab.runs.composition import CONF, override_key, plain, register_library
from pemirl_lab.runs.memory import keep_freed_memory
from pemirl_lab.runs.own_help import help_on_own
from pemirl_lab.runs.own_task import is_own, parse_words
from pemirl_lab.runs.places import RunRefused
from pemirl_lab.runs.run_folder import say
from pemirl_lab.runs.settings import parse
from pemirl_lab.runs.tables import Table, read_table

OWN_TASK = ("meta_train", "adapt_reward", "reward_report")
"""What also runs on an environment of the user's own, with ``env=my_module:make_env``."""
JOBS = 2
"""Rows of a table side by side, where nothing else is said: each holds its rollouts in memory."""


def run(command: str, arguments: Sequence[str], what: str) -> None:
    """Run a command with overrides; ``what`` it does is the head of its help.

    Raises:
        SystemExit: a wrong value, or an interruption; its message says what to do.
    """
    if command in OWN_TASK and is_own(arguments):
        run_own(command, arguments)
        return
    # Hydra drops a chosen group with ~; null is what one tries first.
    given = ["~experiment" if text == "experiment=null" else text for text in arguments]
    if command == "reproduce":
        given = _expanded(given)
    if {"-h", "--help"} & set(given):
        if command in OWN_TASK:
            what += (
                f"; of an environment of your own: pemirl {command} env=my_module:make_env --help"
            )
        quoted = what.replace("'", "\\'")
        header = f"hydra.help.header='pemirl {command}: {quoted}'"
        given = [header, *(text for text in given if text not in ("-h", "--help")), "--help"]
    register_library()
    importlib.import_module(f"pemirl_lab.commands.{command}")  # before Hydra shows what MuJoCo logs
    sys.argv = ["pemirl", *given]
    hydra.main(config_path=str(CONF), config_name=command, version_base="1.3")(_job(command))()


def _job(command: str) -> Callable[[DictConfig], None]:
    """What Hydra calls with the resolved configuration, also in processes that launchers start."""

    def job(config: DictConfig) -> None:
        module = importlib.import_module(f"pemirl_lab.commands.{command}")
        execute(module, command, config)

    return job


def execute(module: ModuleType, command: str, config: DictConfig) -> None:
    """Run a command's module on a composed configuration."""
    try:
        resolved = _row(config) if command == "reproduce" else plain(config)
        settings, own = parse(resolved, module.Own)
    except ValueError as error:
        sys.exit(f"pemirl {command}: {error}")
    # Sums of floats depend on how many threads share them: with a fixed number, a run's results are
    # those of its seed, whatever ``threads`` gives the simulator.
    torch.set_num_threads(settings.torch_threads)
    _resumable([command, *sys.argv[1:]], settings.run_dir, lambda: module.run(settings, own))


def run_own(command: str, given: Sequence[str]) -> None:
    """Run a command on an environment of the user's own.

    Raises:
        SystemExit: a wrong value, environment or file, or an interruption; says what to do.
    """
    module = importlib.import_module(f"pemirl_lab.commands.{command}")
    if {"-h", "--help"} & {*given}:
        say(help_on_own(command, module))
        return
    torch.set_num_threads(1)  # as in execute
    words = [text for text in given if text not in ("--cfg", "-c", "job")]
    try:
        task = parse_words(words, module.OwnEnvironment, rest=True)
        if len(words) < len(given):  # what it would run, without running it
            say(module.settings_found(task) if hasattr(module, "settings_found") else f"{task}")
            return
        _resumable([command, *given], task.run_dir, lambda: module.run_own(task))
    except (ValueError, TypeError, ImportError) as error:
        if not _is_ours(error):
            raise
        sys.exit(f"pemirl {command}: {error}")


def _is_ours(error: Exception) -> bool:
    """Whether this project raised it; an error in the user's module needs its traceback."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    name = "" if trace is None else str(trace.tb_frame.f_globals.get("__name__"))
    return name.startswith("pemirl_")


def _resumable(words: Sequence[str], run_dir: str, work: Callable[[], object]) -> None:
    """Do the work; where it is interrupted, say how to go on."""
    keep_freed_memory()
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        work()
    except (RunRefused, FileNotFoundError) as error:
        sys.exit(f"pemirl {words[0]}: {error}")
    except KeyboardInterrupt:
        again = shlex.join(["pemirl", *words])
        sys.exit(f"\nstopped; {run_dir} keeps what it has. To go on from there: {again}")


def _interrupt(signum: int, frame: Any) -> NoReturn:
    raise KeyboardInterrupt


# --- reproduce: rows and seeds of a table ------------------------------------------------------


def _expanded(arguments: Sequence[str]) -> list[str]:
    """Give ``reproduce`` every row and seed of its table, unless it is told which.

    With ``--list``, show one command for each of them and leave; with ``--cfg``, Hydra is to show
    what one row runs.
    """
    given = [text for text in arguments if text not in ("--list", "-m", "--multirun")]
    shown = bool({"-c", "--cfg"} & set(given))
    if not shown and any(text.startswith("-") for text in given):  # --help: Hydra's own business
        return list(arguments)
    values = dict(text.split("=", 1) for text in given if "=" in text)
    try:
        table = read_table(values.get("table", "point_maze"))
        if shown:
            return _of_one_row(table, given, values.get("row", "pemirl"))
        rows = values.get("row", ",".join(table.rows)).split(",")
        most = max(table.seeds_of(row) for row in rows)
    except ValueError as error:
        sys.exit(f"pemirl reproduce: {error}")
    seeds = values.get("seed", ",".join(map(str, range(most))))
    rest = [text for text in given if text.split("=", 1)[0] not in ("row", "seed")]
    if "--list" in arguments:
        listed = (
            shlex.join(["pemirl", "reproduce", *rest, f"row={row}", f"seed={seed}"])
            for row in rows
            for seed in seeds.split(",")
            if not seed.isdigit() or int(seed) < table.seeds_of(row)
        )
        sys.stdout.write("\n".join(listed) + "\n")
        sys.exit(0)
    if not any(text.startswith(("hydra/launcher=", "hydra.launcher.n_jobs=")) for text in rest):
        rest.append(f"hydra.launcher.n_jobs={JOBS}")
    return ["--multirun", *rest, f"row={','.join(rows)}", f"seed={seeds}"]


def _of_one_row(table: Table, given: Sequence[str], row: str) -> list[str]:
    """The row's own overrides beside those given, and what is none of them (``--cfg job``)."""
    overrides = [text for text in given if "=" in text]
    overrides = [text for text in overrides if override_key(text) not in ("table", "row")]
    return [*(text for text in given if "=" not in text), *table.chosen(row, overrides)]


def _row(config: DictConfig) -> dict[str, Any]:
    """The row's own configuration: its overrides, and then those of the command line."""
    overrides = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    given = [text for text in overrides if override_key(text) not in ("table", "row")]
    return read_table(config.table).compose(config.row, given)
