"""docs/tutorial.md, from its first command to its last number, with trainings of seconds."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pemirl_lab import cli

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/tutorial.md").read_text("utf-8")
FEW = {
    "meta_train": """meta_il.steps=100 contexts_per_batch=10 training.iterations=2
        training.rollouts_per_context=2 training.batch.trajectories=10""",
    "adapt_reward": "rollouts=20 optimization.iterations=2",
}


def commands():
    """The lines of the page's bash blocks, in their order."""
    blocks = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
    return [shlex.split(line) for block in blocks for line in block.splitlines()]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copy(ROOT / "examples/own_pendulum/pendulum.py", tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_tutorial_runs(folder, monkeypatch, capsys):
    for program, *words in commands():
        if program == "python":
            subprocess.run([sys.executable, *words], check=True, cwd=folder)
            continue
        assert program == "pemirl"
        few = FEW.get(words[0], "").split()
        monkeypatch.setattr(sys, "argv", ["pemirl", *words, *few])
        cli.main()
    shown = capsys.readouterr().out
    assert "nothing suspicious" in shown
    assert "learned return:" in shown
    names: dict[str, object] = {}
    for snippet in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(snippet, "docs/tutorial.md", "exec"), names)
    assert (folder / "reward_over_angle.png").stat().st_size > 10_000
    returns = eval(capsys.readouterr().out)
    assert set(returns) == set(names["returns"])
    assert max(returns, key=returns.get) == "who knows the angle and the motor"
