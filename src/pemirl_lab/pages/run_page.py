"""One HTML page of a run: health, returns, curves, maps, films and settings, in one file.

    pemirl run_page run_dir=runs/quickstart/point_maze/pemirl_robust/seed0

Writes ``index.html`` to the run's folder, from what the run left there: nothing is trained or
rendered. It holds all that it shows and can be sent to somebody. Films are those of ``pemirl
record_video`` with an ``output`` in the folder. The quickstart, ``meta_train`` and ``adapt_reward``
write the page by themselves when they are done.
"""

from __future__ import annotations

import base64
import io
import sys
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from pydantic.dataclasses import dataclass

from pemirl_lab.pages.health_figures import metric_panels
from pemirl_lab.pages.tables import returns_table
from pemirl_lab.results import read
from pemirl_lab.runs.own_task import parse_words
from pemirl_lab.runs.places import RunRefused
from pemirl_lab.runs.run_folder import read_json, read_run, read_seconds, say
from pemirl_trl.configuration import CHECKED
from pemirl_trl.files import atomic_path
from pemirl_trl.methods.health_log import read_health, replayed

LARGEST_FILM = 20_000_000
"""Bytes; a larger film is named, not embedded."""

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1100px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem}h2{font-size:1.2rem;border-bottom:1px solid #ddd;margin-top:2rem}
h3{font-size:1rem}table{border-collapse:collapse;margin:.5rem 0;font-size:.85rem;display:block;
overflow-x:auto}th,td{border:1px solid #ddd;padding:.25rem .5rem;text-align:left;vertical-align:top}
th{background:#f5f5f5}img,video{max-width:100%}.well{color:#00664b}.sick{color:#a8430a}
.quiet{color:#666;font-size:.85rem}"""


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
    title = " · ".join([*what, f"seed {record.get('seed', '?')}"])
    body = [f"<h1>{escape(title)}</h1>", f"<p class=quiet>{escape(str(run))}</p>"]
    body += [*_stages(run), *_returns(run, record), *_pictures(run), *_films(run)]
    body += _settings(run, record)
    head = f"<meta charset=utf-8><title>{escape(title)}</title><style>{_STYLE}</style>"
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(body)}</body></html>\n"


def _stages(run: Path) -> Iterator[str]:
    """Health and curves of each stage, in the order in which they were trained."""
    files = sorted((run / "health").glob("*.json"), key=lambda file: file.stat().st_mtime)
    stages = {file.stem: read_health(file)[0] for file in files}
    health = {stage: replayed(rows) for stage, rows in stages.items() if rows}
    yield "<h2>Health</h2>"
    if not health:
        yield "<p>no stage has left its metrics here</p>"
    for stage, found in health.items():
        verdict = "sick" if found.findings else "well"
        yield f"<h3 class={verdict}>{escape(stage)}</h3>{_markdown(found.summary())}"
    yield "<h2>Learning curves</h2>" if health else ""
    for stage, found in health.items():
        figure = metric_panels(stages[stage], found.findings)
        yield f"<h3>{escape(stage)}</h3>{_image(_svg(figure), 'image/svg+xml', stage)}"


def _returns(run: Path, record: Mapping[str, Any]) -> Iterator[str]:
    results = [read(file) for file in sorted(Path(str(record.get("results", ""))).glob("*.json"))]
    adaptation = read_json(run / "adaptation.json")
    if results or adaptation:
        yield "<h2>Returns</h2>"
    if results:
        yield _markdown(returns_table(results))
    if adaptation:
        yield _table(["what", "value"], [[k, _text(v)] for k, v in adaptation.items()])


def _pictures(run: Path) -> Iterator[str]:
    files = sorted((run / "figures").glob("*.png"))
    if files:
        yield "<h2>Figures</h2>"
    for file in files:
        name = file.stem.replace("_", " ")
        yield f"<h3>{escape(name)}</h3>{_image(file.read_bytes(), 'image/png', name)}"


def _films(run: Path) -> Iterator[str]:
    files = sorted(run.rglob("*.mp4"))
    if files:
        yield "<h2>Films</h2>"
    for file in files:
        name = file.relative_to(run).as_posix()
        yield f"<h3>{escape(name)}</h3>"
        if file.stat().st_size > LARGEST_FILM:
            yield f"<p>{file.stat().st_size:,} bytes: too large to be embedded</p>"
            continue
        yield f'<video controls loop muted src="{_data(file.read_bytes(), "video/mp4")}"></video>'


def _settings(run: Path, record: Mapping[str, Any]) -> Iterator[str]:
    seconds = read_seconds(run)
    if seconds:
        rows = [[stage, f"{value / 60:.1f}"] for stage, value in seconds.items()]
        yield f"<h2>Time</h2>{_table(['stage', 'minutes'], rows)}"
    rows = [[name, _text(value)] for name, value in _flat(record)]
    yield "<h2>Settings</h2><details><summary>all of them, and the versions</summary>"
    yield f"{_table(['name', 'value'], rows)}</details>"


def _flat(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in node.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


# --- HTML --------------------------------------------------------------------------------------


def _markdown(text: str) -> str:
    """A Markdown table, or a line of text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    if not lines:
        return f"<p>{escape(text)}</p>"
    cells = [[cell.strip() for cell in line.strip()[1:-1].split("|")] for line in lines]
    return _table(cells[0], cells[2:])


def _table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in heading)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return "; ".join(_text(item) for item in value)
    if isinstance(value, Mapping):
        return "; ".join(f"{name} {_text(item)}" for name, item in value.items())
    return str(value)


def _image(content: bytes, kind: str, text: str) -> str:
    return f'<img alt="{escape(text)}" src="{_data(content, kind)}">'


def _data(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _svg(figure: Figure) -> bytes:
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    return content.getvalue()
