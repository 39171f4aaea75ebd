"""``pemirl COMMAND key=value ...``: everything that the recipes do, from anywhere.

What it takes to run one is imported when one is run: the list of them is there at once.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from ctypes.util import find_library

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

OTHERS: Mapping[str, tuple[str, str]] = {
    "infer": ("pemirl_lab.measuring.infer", "m and r of one demonstration, and how far off it is"),
    "find_task_space": (
        "pemirl_lab.measuring.find_task_space",
        "what a reward may read, from demonstrations by several bodies",
    ),
    "export_reward": ("pemirl_lab.measuring.export_reward", "a reward, with its card, to a file"),
    "export_model": ("pemirl_lab.measuring.export_model", "a model, with its card, to a file"),
    "check": ("pemirl_lab.measuring.check", "what is suspicious about a file of demonstrations"),
    "film_strip": ("pemirl_lab.pages.film_strip", "a film as a picture, a row per episode"),
    "run_page": (
        "pemirl_lab.pages.run_page",
        "one HTML page of a run: health, curves, maps",
    ),
    "report": ("pemirl_lab.pages.report", "the generated parts of the pages, from results files"),
}
"""What takes arguments of its own: the module, and what it does."""

USAGE = """usage: pemirl COMMAND [key=value ...]

{commands}

pemirl COMMAND --help       its values, with their defaults
pemirl COMMAND --cfg job    what it would run, without running it

Start with:                 pemirl quickstart preset=smoke     (seconds: does it run here?)
                            pemirl quickstart                  (minutes: Point-Maze, whole)
Another domain:             pemirl quickstart experiment=ant   (or sweeper, sawyer_pusher)
Your own environment:       pemirl meta_train demonstrations=FILE env=my_module:make_env run_dir=R
Completion, also of values: eval "$(pemirl -sc install=bash)"
"""


def main() -> None:
    """Entry point of the console command."""
    arguments = sys.argv[1:]
    if {"-h", "--help"} & set(arguments) and hasattr(signal, "SIGPIPE"):
        # Help into a pager that is left ends, without a traceback.
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    if not arguments or arguments[0] in ("-h", "--help"):
        sys.stdout.write(usage())
    elif arguments[0] == "--version":
        sys.stdout.write(f"pemirl-trl {importlib.import_module('pemirl_trl').__version__}\n")
    elif arguments[0] in ("-sc", "--shell-completion"):
        complete(arguments)
    elif arguments[0] in OTHERS:
        _before_imports()
        importlib.import_module(OTHERS[arguments[0]][0]).main(arguments[1:])
    elif arguments[0] in COMMANDS:
        run(arguments[0], arguments[1:])
    else:
        sys.exit(f"pemirl: no command {arguments[0]!r}\n\n{usage()}")


def run(command: str, arguments: Sequence[str] | None = None) -> None:
    """Run a command with overrides; None takes those of this process's command line."""
    _before_imports()
    given = sys.argv[1:] if arguments is None else arguments
    importlib.import_module("pemirl_lab.runner").run(command, given, COMMANDS[command])


def complete(arguments: Sequence[str]) -> None:
    """Answer a shell: the commands here, and what comes after one by Hydra.

    Hydra completes programs of one name, so it is shown the line without the command.
    """
    line = os.environ.get("COMP_LINE", "")
    name, _, rest = line.lstrip().partition(" ")
    command, space, values = rest.lstrip().partition(" ")
    if space and command in COMMANDS:
        os.environ["COMP_LINE"] = f"{name} {values}"
    elif line:
        sys.stdout.write(" ".join([*COMMANDS, *OTHERS]) + "\n")
        return
    else:  # to be installed: the script is the same for all of them
        command = "quickstart"
    run(command, arguments)


def usage() -> str:
    """The commands, in one screen."""
    every = {**COMMANDS, **{name: what for name, (_, what) in OTHERS.items()}}
    return USAGE.format(commands="\n".join(f"  {name:<16} {what}" for name, what in every.items()))


def _before_imports() -> None:
    """What libraries read when they are loaded."""
    # Threads of torch that wait for each other spin, unless told to sleep: on a busy machine that
    # is many times slower than one thread.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    _without_a_screen()


def _without_a_screen() -> None:
    """Where there is none, MuJoCo's own choice would look for one, and complain."""
    if "DISPLAY" not in os.environ:
        headless = "osmesa" if find_library("OSMesa") else "disable"
        os.environ.setdefault("MUJOCO_GL", headless)
    if os.environ.get("MUJOCO_GL") == "osmesa" and not find_library("OSMesa"):
        sys.exit(
            "pemirl: MUJOCO_GL=osmesa, but there is no OSMesa library: install it (Debian: apt-get "
            "install --no-install-recommends libosmesa6), or go without pictures: MUJOCO_GL=disable"
        )


if __name__ == "__main__":
    main()
