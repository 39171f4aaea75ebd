"""The README's snippets run, in order, and all pages' tables are those of the results files."""

import re
from pathlib import Path

from pemirl_lab.pages import report

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_snippets_run(monkeypatch):
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for snippet in SNIPPETS:
        exec(compile(snippet, "README.md", "exec"), names)
    assert names["reward"].shape == (1, 1)


def test_pages_are_what_the_results_files_give():
    assert report.stale(ROOT, report.generate(ROOT)) == []


def test_the_two_commands_are_there():
    for session in ("quickstart", "tests"):
        assert f"\npip install nox && nox -s {session}\n" in README


def test_the_counts_of_damage_are_those_of_the_stored_campaign():
    counts = (ROOT / "results/robustness.txt").read_text(encoding="utf-8")
    kills = sum(map(int, re.findall(r": (\d+) kills, \d+ runs, all as the one", counts)))
    files = sum(map(int, re.findall(r": tried (\d+), ", counts)))
    tried, refused = re.findall(r"overrides: (\d+) tried, (\d+) refused by name", counts)[0]
    assert tried == refused
    told = f"({kills} kills, all runs identical; {files:,} files and {int(tried):,} values"
    assert told in README
