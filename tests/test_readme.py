"""The README's snippets run, in order, and its tables are those of the results files."""

import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.filterwarnings("ignore::FutureWarning")  # a user's trainer need not silence TorchRL's
def test_snippets_run(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for snippet in SNIPPETS:
        exec(compile(snippet, "README.md", "exec"), names)
    assert "TrustRegionResult(" in capsys.readouterr().out
    assert len(SNIPPETS) == 4


def test_tables_are_those_of_the_results_files():
    report = subprocess.run(
        [sys.executable, str(ROOT / "recipes/report.py")],
        check=True,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    between = README.split("<!-- results:begin -->\n")[1].split("<!-- results:end -->")[0]
    assert between == report.stdout


def test_pictures_and_links_exist():
    for target in re.findall(r"\]\(((?!http|#)[^)]+)\)", README):
        assert (ROOT / target).exists(), target
