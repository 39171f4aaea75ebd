"""``pemirl COMMAND key=value ...``: everything that the recipes do, from anywhere.

A command is a module of :mod:`pemirl_lab.commands` with a YAML file of its name in ``conf/``: its
``Own`` says what values it has besides :class:`~pemirl_lab.runs.settings.Settings`, its ``run``
does it.
"""

from __future__ import annotations

import importlib
import shlex
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any, NoReturn

COMMANDS: Mapping[str, str] = {
    "quickstart": "meta-train, adapt and evaluate, in one run",
    "meta_train": "Meta-IL, then PEMIRL or a baseline, on unlabelled demonstrations",
    "adapt_reward": "a policy on the reward of one demonstration, under changed dynamics",
    "evaluate": "table, results files, reward maps and learning curves of these two",
    "reward_report": "how close a learned reward is to the true one, on one page",
    "record_video": "film a policy",
    "train_expert": "an expert on the true reward",
    "collect_demos": "an expert's demonstrations",
    "measure_experts": "what a task's experts reach, also where the dynamics have changed",
    "reproduce": "the rows of a table of experiments, over seeds",
}
"""What there is, in the order of a first visit."""

PAGES = "report"
USAGE = """usage: pemirl COMMAND [key=value ...]

{commands}
  {report:<16} the generated parts of the pages, from the results files

pemirl COMMAND --help       its values, with their defaults
pemirl COMMAND --cfg job    what it would run, without running it

Start with:                 pemirl quickstart preset=smoke     (seconds: does it run here?)
                            pemirl quickstart                  (minutes: Point-Maze, whole)
Another domain:             pemirl quickstart experiment=ant   (or sweeper, sawyer_pusher)
Completion of values:       eval "$(pemirl COMMAND -sc install=bash)"
"""


def main() -> None:
    """Entry point of the console command."""
    arguments = sys.argv[1:]
    if not arguments or arguments[0] in ("-h", "--help"):
        sys.stdout.write(usage())
    elif arguments[0] == "--version":
        sys.stdout.write(f"pemirl-trl {importlib.import_module('pemirl_trl').__version__}\n")
    elif arguments[0] == PAGES:
        importlib.import_module("pemirl_lab.pages.report").main(arguments[1:])
    elif arguments[0] in COMMANDS:
        run(arguments[0], arguments[1:])
    else:
        sys.exit(f"pemirl: no command {arguments[0]!r}\n\n{usage()}")


def usage() -> str:
    """The commands, in one screen."""
    lines = "\n".join(f"  {name:<16} {what}" for name, what in COMMANDS.items())
    return USAGE.format(commands=lines, report=PAGES)


def run(command: str, arguments: Sequence[str] | None = None) -> None:
    """Run a command with overrides; None takes those of this process's command line.

    Raises:
        SystemExit: a wrong value, or an interruption; its message says what to do.
    """
    import hydra  # slow to import: `pemirl --help` does without

    from pemirl_lab.runs.composition import CONF, register_library

    given = list(sys.argv[1:] if arguments is None else arguments)
    if command == "reproduce":
        given = _expanded(given)
    if {"-h", "--help"} & set(given):
        given.append(f"hydra.help.header='pemirl {command}: {COMMANDS[command]}'")
    register_library()
    sys.argv = [f"pemirl_{command}", *given]
    hydra.main(config_path=str(CONF), config_name=command, version_base="1.3")(_job(command))()


def _job(command: str) -> Callable[[Any], Any]:
    """What Hydra calls with the resolved configuration, also in processes that launchers start."""

    def job(config: Any) -> None:
        module = importlib.import_module(f"pemirl_lab.commands.{command}")
        execute(module, command, config)

    return job


def execute(module: ModuleType, command: str, config: Any) -> None:
    """Run a command's module on a composed configuration."""
    import torch

    from pemirl_lab.runs.composition import plain
    from pemirl_lab.runs.settings import parse

    # One thread: sums of floats depend on how many share them, so this makes a run's results those
    # of its seed, whatever ``threads`` gives the simulator. On a busy machine more would only spin.
    torch.set_num_threads(1)
    try:
        resolved = _row(config) if command == "reproduce" else plain(config)
        settings, own = parse(resolved, module.Own)
    except ValueError as error:
        sys.exit(f"pemirl {command}: {error}")
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        module.run(settings, own)
    except KeyboardInterrupt:
        again = shlex.join(["pemirl", command, *sys.argv[1:]])
        sys.exit(f"\nstopped; {settings.run_dir} keeps what it has. To go on from there: {again}")


def _interrupt(signum: int, frame: Any) -> NoReturn:  # noqa: ARG001 (the signature of a handler)
    raise KeyboardInterrupt


# --- reproduce: rows and seeds of a table ------------------------------------------------------


def _expanded(arguments: Sequence[str]) -> list[str]:
    """Give ``reproduce`` every row and seed of its table, unless it is told which.

    With ``--list``, show one command for each of them and leave.
    """
    from pemirl_lab.runs.tables import read_table

    given = [text for text in arguments if text not in ("--list", "-m", "--multirun")]
    if any(text.startswith("-") for text in given):  # --help, --cfg: Hydra's own business
        return list(arguments)
    values = dict(text.split("=", 1) for text in given if "=" in text)
    try:
        table = read_table(values.get("table", "point_maze"))
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
    return ["--multirun", *rest, f"row={','.join(rows)}", f"seed={seeds}"]


def _row(config: Any) -> dict[str, Any]:
    """The row's own configuration: its overrides, and then those of the command line."""
    from hydra.core.hydra_config import HydraConfig

    from pemirl_lab.runs.composition import override_key
    from pemirl_lab.runs.tables import read_table

    overrides = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    given = [text for text in overrides if override_key(text) not in ("table", "row")]
    return read_table(config.table).compose(config.row, given)


if __name__ == "__main__":
    main()
