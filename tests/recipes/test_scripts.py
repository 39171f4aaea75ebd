"""Each script is a docstring, an import and a call: the command of its name."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pemirl_lab.cli import COMMANDS

RECIPES = Path(__file__).parents[2] / "recipes"
CALL = "if __name__ == '__main__':\n    run('{name}')"


def test_every_command_is_a_script():
    assert {file.stem for file in RECIPES.glob("*.py")} == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_script_is_a_docstring_an_import_and_a_call(name):
    tree = ast.parse((RECIPES / f"{name}.py").read_text(encoding="utf-8"))
    documented, *statements = tree.body
    assert ast.get_docstring(tree)
    assert isinstance(documented, ast.Expr)
    assert [ast.unparse(statement) for statement in statements] == [
        "from pemirl_lab.cli import run",
        CALL.format(name=name),
    ]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_script_and_its_command_are_documented_alike(name):
    """But for how they are called."""
    script, command = (
        ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
        for file in (RECIPES / f"{name}.py", command_file(name))
    )
    assert words(script.replace(f"python recipes/{name}.py", f"pemirl {name}")) == words(command)


def command_file(name):
    return RECIPES.parent / f"src/pemirl_lab/commands/{name}.py"


def words(text):
    """Without the comments beside examples, which name scripts or commands."""
    return [word for line in text.splitlines() for word in line.split("#")[0].split()]


def test_a_script_is_run_as_it_stands(tmp_path):
    """What the help of each command says is in the tests of the runner."""
    done = subprocess.run(
        [sys.executable, str(RECIPES / "quickstart.py"), "--help"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=os.environ | {"MUJOCO_GL": "disable"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"pemirl quickstart: {COMMANDS['quickstart']}\n")
    assert list(tmp_path.iterdir()) == []
