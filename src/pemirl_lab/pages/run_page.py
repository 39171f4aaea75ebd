"""One HTML page of a run: health, returns, curves, maps, films and settings, in one file.

    pemirl run_page run_dir=runs/quickstart/point_maze/pemirl_robust/seed0

Writes ``index.html`` to the run's folder, from what the run left there: nothing is trained or
rendered. It holds all that it shows and can be sent to somebody. Films are those of ``pemirl
record_video`` with an ``output`` in the folder. The quickstart, ``meta_train`` and ``adapt_reward``
write the page by themselves when they are done.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from pydantic.dataclasses import dataclass

from pemirl_lab.pages import html
from pemirl_lab.pages.health_figures import metric_panels
from pemirl_lab.pages.tables import parse_markdown_table, returns_table
from pemirl_lab.results import read
from pemirl_lab.runs.own_task import parse_words
from pemirl_lab.runs.places import RunRefused
from pemirl_lab.runs.run_folder import read_json, read_run, read_seconds, say
from pemirl_trl.configuration import CHECKED
from pemirl_trl.files import atomic_path
from pemirl_trl.methods.health_log import read_health, replayed

LARGEST_FILM = 20_000_000
"""Bytes; a larger film is named, not embedded."""


@dataclass(frozen=True, config=CHECKED)
class Words:
    """The values of this command: the folder of a run."""

    run_dir: str


def main(arguments: Sequence[str]) -> None:
    """Entry point."""
    if {"-h", "--help"} & set(arguments):
        say(str(__doc__))
        return
    try:
        run = Path(parse_words(arguments, Words).run_dir).expanduser()
        if not (run / "config.yaml").exists():
            raise FileNotFoundError(f"{run} is no folder of a run: it holds no config.yaml")
        write_run_page(run)
    except (FileNotFoundError, ValueError, RunRefused) as error:
        sys.exit(f"pemirl run_page: {error}")


def write_run_page(run: Path) -> Path:
    """Write ``index.html`` of a run's folder, and say so."""
    file = run / "index.html"
    with atomic_path(file) as temporary:
        temporary.write_text(run_page(run), encoding="utf-8")
    say(f"page of the run -> {file}")
    return file


def run_page(run: Path) -> str:
    """The page of a run's folder.

    Raises:
        RunRefused, ValueError: a file of the run is damaged; says which.
    """
    record = read_run(run)
    what = [str(record[key]) for key in ("task", "method", "env") if key in record]
    sections = {
        "Health": _health(run),
        "Returns": _returns(run, record),
        "Figures": _pictures(run),
        "Films": _films(run),
        "Time": _time(run),
        "Settings, and the versions": [html.facts({k: _text(v) for k, v in _flat(record)})],
    }
    parts = [html.section(title, found) for title, part in sections.items() if (found := [*part])]
    title = " · ".join([*what, f"seed {record.get('seed', '?')}"])
    return html.page(title, [html.paragraph(str(run)), *parts])


def _health(run: Path) -> Iterator[str]:
    """Signs and curves of each stage, in the order in which they were trained."""
    files = sorted((run / "health").glob("*.json"), key=lambda file: file.stat().st_mtime)
    stages = {file.stem: read_health(file)[0] for file in files}
    if not any(stages.values()):
        yield html.paragraph("no stage has left its metrics here")
    for stage, rows in stages.items():
        if rows:
            found = replayed(rows)
            curves = _svg(metric_panels(rows, found.findings))
            parts = [_markdown(found.summary()), html.picture(curves, "image/svg+xml", stage)]
            yield html.subsection(stage, parts, "sick" if found.findings else "well")


def _returns(run: Path, record: Mapping[str, Any]) -> Iterator[str]:
    results = [read(file) for file in sorted(Path(str(record.get("results", ""))).glob("*.json"))]
    adaptation = read_json(run / "adaptation.json")
    if results:
        yield _markdown(returns_table(results))
    if adaptation:
        yield html.facts({name: _text(value) for name, value in adaptation.items()})


def _pictures(run: Path) -> Iterator[str]:
    for file in sorted((run / "figures").glob("*.png")):
        yield html.picture(file.read_bytes(), "image/png", file.stem.replace("_", " "))


def _films(run: Path) -> Iterator[str]:
    for file in sorted(run.rglob("*.mp4")):
        name, size = file.relative_to(run).as_posix(), file.stat().st_size
        if size > LARGEST_FILM:
            yield html.paragraph(f"{name}: {size:,} bytes, too large to be embedded")
        else:
            yield html.film(file.read_bytes(), name)


def _time(run: Path) -> Iterator[str]:
    seconds = read_seconds(run)
    if seconds:
        rows = [[stage, f"{value / 60:.1f}"] for stage, value in seconds.items()]
        yield html.table(["stage", "minutes"], rows)


def _flat(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in node.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _markdown(text: str) -> str:
    """A Markdown table, or a line of text."""
    cells = parse_markdown_table(text)
    return html.table(cells[0], cells[1:]) if cells else html.paragraph(text)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return "; ".join(_text(item) for item in value)
    if isinstance(value, Mapping):
        return "; ".join(f"{name} {_text(item)}" for name, item in value.items())
    return str(value)


def _svg(figure: Figure) -> bytes:
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    return content.getvalue()
