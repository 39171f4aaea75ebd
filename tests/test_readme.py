"""The README's snippets run, in order, and all pages' tables are those of the results files."""

import pathlib
import re

import pytest

from pemirl_lab.pages import report

ROOT = pathlib.Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted(str(page.relative_to(ROOT)) for page in (ROOT / "docs").glob("*.md"))
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.filterwarnings("ignore::FutureWarning")  # a user's trainer need not silence TorchRL's
def test_snippets_run(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for snippet in SNIPPETS:
        exec(compile(snippet, "README.md", "exec"), names)
    assert "TrustRegionResult(" in capsys.readouterr().out
    assert len(SNIPPETS) == 4


def test_pages_are_what_the_results_files_give():
    assert report.stale(ROOT, report.generate(ROOT)) == []


def anchors(page):
    """The anchors that GitHub gives to a page's headings."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", ["README.md", "recipes/README.md", "data/README.md", *PAGES])
def test_pictures_and_links_exist(page):
    page = ROOT / page
    for target in re.findall(r"\]\(((?!http)[^)\s]+)\)", page.read_text(encoding="utf-8")):
        name, _, anchor = target.partition("#")
        linked = page.parent / name if name else page
        assert linked.exists(), target
        assert not anchor or anchor in anchors(linked), target
