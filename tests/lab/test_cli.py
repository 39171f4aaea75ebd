"""The console command: its list, its errors, completion."""

import importlib
import os
import subprocess
import sys

import pytest

from pemirl_lab import cli

FAST = """
import sys
sys.argv = ["pemirl", *sys.argv[1:]]
from pemirl_lab.cli import main
try:
    main()
finally:
    heavy = {"torch", "hydra", "omegaconf", "mujoco", "matplotlib"} & set(sys.modules)
    print("imported:", *sorted(heavy))
"""


@pytest.fixture
def main(here, monkeypatch):
    def main(*arguments):
        monkeypatch.setattr(sys, "argv", ["pemirl", *arguments])
        cli.main()

    return main


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_the_commands_are_listed_with_what_they_do(main, capsys, arguments):
    main(*arguments)
    shown = capsys.readouterr().out
    for name, what in cli.COMMANDS.items():
        assert f"\n  {name:<16} {what}\n" in shown
    assert "\n  report           the generated parts of the pages" in shown


def test_the_list_is_there_at_once(process, tmp_path):
    done = process("--help", cwd=tmp_path, code=FAST)
    assert done.stdout.startswith("usage: pemirl COMMAND")
    assert done.stdout.endswith("\nimported:\n"), done.stdout + done.stderr


def test_every_command_is_a_module_with_values_and_a_recipe():
    here = importlib.resources.files("pemirl_lab")
    modules = {file.stem for file in (here / "commands").glob("*.py")} - {"__init__"}
    assert modules == set(cli.COMMANDS)
    assert {file.stem for file in (here / "conf").glob("*.yaml")} == {*cli.COMMANDS, "config"}


def test_an_unknown_command_lists_those_that_there_are(main):
    with pytest.raises(SystemExit, match=r"^pemirl: no command 'nonsense'\n\nusage: .*") as left:
        main("nonsense")
    assert "\n  quickstart " in str(left.value)


def test_the_version_is_the_librarys(main, capsys):
    main("--version")
    version = importlib.import_module("pemirl_trl").__version__
    assert capsys.readouterr().out == f"pemirl-trl {version}\n"


def test_the_pages_are_a_command_too(main, capsys):
    with pytest.raises(SystemExit):
        main("report", "--help")
    assert "--check" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("pemirl ", ["quickstart", "meta_train", "report"]),
        ("pemirl meta", ["meta_train", "measure_experts"]),
        ("pemirl meta_train method=pemirl_", ["method=pemirl_robust", "method=pemirl_no_info"]),
        ("pemirl meta_train task", ["task="]),
        ("pemirl reproduce training.iter", ["training.iterations="]),
    ],
)
def test_a_shell_is_told_what_may_come(main, monkeypatch, capsys, command, line, offered):
    monkeypatch.setenv("COMP_LINE", line)
    main("-sc", "query=bash")
    assert set(offered) <= set(capsys.readouterr().out.split())


BASH = """
eval "$(pemirl -sc install=bash)"
complete -p pemirl
complete_line() {
    COMP_LINE="$1"; COMP_POINT=${#COMP_LINE}; COMP_CWORD=$2
    hydra_bash_completion
    echo "${COMPREPLY[@]}"
}
complete_line "pemirl qui" 1
complete_line "pemirl meta_train experiment=s" 2
"""


def test_bash_completes_the_second_word_and_values(tmp_path):
    program = tmp_path / "pemirl"
    program.write_text(
        f"#!{sys.executable}\nfrom pemirl_lab.cli import main\nmain()\n", encoding="utf-8"
    )
    program.chmod(0o755)
    where = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "MUJOCO_GL": "disable"}
    done = subprocess.run(
        ["bash", "-c", BASH], capture_output=True, text=True, env=os.environ | where
    )
    rule, commands, values = done.stdout.splitlines()
    assert rule.endswith("-F hydra_bash_completion pemirl"), done.stderr
    assert commands == "quickstart"
    assert values == "experiment=sawyer_pusher experiment=sweeper"


@pytest.mark.parametrize(("given", "then"), [(None, "passive"), ("active", "active")])
def test_threads_of_torch_sleep_while_they_wait_unless_told_otherwise(monkeypatch, given, then):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    monkeypatch.setenv("OMP_WAIT_POLICY", given or "to be restored afterwards")
    if given is None:
        monkeypatch.delenv("OMP_WAIT_POLICY")
    cli._before_imports()
    assert os.environ["OMP_WAIT_POLICY"] == then
