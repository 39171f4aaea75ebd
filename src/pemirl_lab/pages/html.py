"""One HTML file that holds all it shows: text, tables, and figures as inline pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from pemirl_trl.files import atomic_path

__all__ = [
    "facts",
    "figure",
    "film",
    "page",
    "paragraph",
    "picture",
    "section",
    "subsection",
    "table",
    "write_page",
]

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.55 system-ui, sans-serif; color: #1c1c1c; background: #fff;
       max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2.2rem; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .92rem; }
th, td { padding: .3rem .7rem; border-bottom: 1px solid #ddd; text-align: right; }
th { border-bottom: 2px solid #999; } th:first-child, td:first-child { text-align: left; }
table.facts td { text-align: left; } table.facts td:first-child { color: #555; }
.wide { overflow-x: auto; } code { background: #f3f3f3; padding: .1em .3em; }
figure { margin: 1.2rem 0; } figcaption { color: #555; font-size: .9rem; }
img, video { max-width: 100%; height: auto; }
h3 { font-size: 1rem; } h3.well { color: #00664b; } h3.sick { color: #a8430a; }
"""
_DPI = 110


def paragraph(text: str) -> str:
    """Text, escaped; between backticks it is code."""
    parts = escape(text).split("`")
    marked = (f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))
    return f"<p>{''.join(marked)}</p>"


def section(title: str, parts: Iterable[str]) -> str:
    """Parts below a heading."""
    return "\n".join([f"<h2>{escape(title)}</h2>", *parts])


def subsection(title: str, parts: Iterable[str], mood: str = "") -> str:
    """Parts below a smaller heading; ``mood`` is ``well`` or ``sick``, and colours it."""
    return "\n".join([f'<h3 class="{mood}">{escape(title)}</h3>', *parts])


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column names the rows."""
    lines = [_row(head, "th"), *(_row(row, "td") for row in rows)]
    return f'<div class="wide"><table>\n{"".join(lines)}</table></div>'


def facts(content: Mapping[str, str]) -> str:
    """A table of names and what they are."""
    lines = (_row(pair, "td") for pair in content.items())
    return f'<div class="wide"><table class="facts">\n{"".join(lines)}</table></div>'


def figure(drawn: Figure, caption: str) -> str:
    """A drawing as a picture inside of the page."""
    content = io.BytesIO()
    # Without the writer's version in it: the same figure is the same page.
    drawn.savefig(content, format="png", dpi=_DPI, metadata={"Software": None})
    return picture(content.getvalue(), "image/png", caption)


def picture(content: bytes, kind: str, caption: str) -> str:
    """A picture of a MIME type such as ``image/png``, inside of the page."""
    source = f'<img alt="{escape(caption)}" src="{_inline(content, kind)}">'
    return f"<figure>{source}<figcaption>{escape(caption)}</figcaption></figure>"


def film(content: bytes, caption: str) -> str:
    """An mp4 film inside of the page."""
    source = f'<video controls loop muted src="{_inline(content, "video/mp4")}"></video>'
    return f"<figure>{source}<figcaption>{escape(caption)}</figcaption></figure>"


def page(title: str, parts: Iterable[str]) -> str:
    """A whole page, which refers to nothing outside of itself."""
    head = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style></head>\n"
    )
    return head + "\n".join([f"<body><h1>{escape(title)}</h1>", *parts, "</body></html>\n"])


def write_page(file: Path, title: str, parts: Iterable[str]) -> None:
    """Write a page, atomically."""
    with atomic_path(file) as temporary:
        temporary.write_text(page(title, parts), encoding="utf-8")


def _inline(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _row(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>\n"
