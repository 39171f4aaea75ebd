"""The generated parts of the pages, from the results files and ``docs/pages.yaml``.

    pemirl report            # print them
    pemirl report --write    # put them between the pages' markers, and draw the figures
    pemirl report --check    # fail if a page is not what the results files give

A part named ``headline`` stands between ``<!-- headline:begin -->`` and ``<!-- headline:end -->``;
what is around the markers is written by hand. What a part shows is data: see ``docs/pages.yaml``;
what rows are called stands in their tables.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from fnmatch import filter as fnfilter
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from omegaconf import OmegaConf
from pydantic.dataclasses import dataclass

from pemirl_lab.pages.benchmark_tables import benchmark_parts
from pemirl_lab.pages.comparison import interval_plot, stage_curves
from pemirl_lab.pages.convergence import Stage, convergence_table
from pemirl_lab.pages.figures import save_figure
from pemirl_lab.pages.gap import gap_table
from pemirl_lab.pages.health_tables import health_parts
from pemirl_lab.pages.own_tasks import own_task_parts
from pemirl_lab.pages.rounding import rounding_parts
from pemirl_lab.pages.tables import (
    Column,
    by_seed,
    cost_table,
    improvement_table,
    provenance,
    returns_table,
    reward_table,
    scores_of,
    seeds_table,
)
from pemirl_lab.pages.transfer_table import transfer_parts
from pemirl_lab.results import Result, read_all
from pemirl_lab.runs.composition import plain
from pemirl_lab.runs.places import CHECKOUT
from pemirl_lab.runs.tables import read_table, table_names
from pemirl_trl.configuration import CHECKED, typed
from pemirl_trl.files import atomic_path

Rows = Mapping[str, str]
Drawing = partial[Figure]
"""A figure that is drawn when it is called: only ``--write`` needs it."""


@dataclass(frozen=True, config=CHECKED)
class Item:
    """A table or a figure of a part.

    Args:
        kind: a key of :data:`KINDS`.
        table: the folder below ``results`` that it shows.
        rows: names or patterns such as ``context_*``, which stand for all that match, sorted.
        caption: above it; of a figure, its description.
        options: arguments of the kind's function.
    """

    kind: str
    table: str
    rows: Sequence[str] = ()
    caption: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)


class Pages:
    """Generated text by page and part (``parts``), and figures by file (``figures``)."""

    def __init__(self) -> None:
        self.parts: dict[str, dict[str, str]] = {}
        self.figures: dict[str, Drawing] = {}


# --- kinds -------------------------------------------------------------------------------------


def _convergence(
    results: Sequence[Result],
    rows: Rows,
    *,
    stages: Mapping[str, str],
    variant: str,
    fraction: float = 0.95,
    paper: Mapping[str, float] | None = None,
) -> str:
    chosen = [
        Stage(row=row, stage=stage, variant=variant, label=rows[row], paper=(paper or {}).get(row))
        for row, stage in stages.items()
    ]
    return convergence_table(results, chosen, fraction)


def _curves(
    results: Sequence[Result],
    rows: Rows,
    *,
    stages: Mapping[str, str],
    variant: str,
    title: str = "",
) -> Drawing | None:
    if not any(result.curves.get(stages.get(result.row, "")) for result in results):
        return None
    scores = [s for r in results for s in r.scores if (s.variant, s.goals) == (variant, "all")]
    references = {"expert": scores[0].expert, "random": scores[0].random} if scores else {}
    chosen = {rows[row]: (row, stage) for row, stage in stages.items()}
    return partial(stage_curves, results, chosen, references=references, title=title)


def _intervals(
    results: Sequence[Result], rows: Rows, *, column: Column, title: str = ""
) -> Drawing | None:
    if not any(scores_of(results, row, column) for row in rows):
        return None
    return partial(interval_plot, results, column, rows, title=title)


KINDS: Mapping[str, Callable[..., str | Drawing | None]] = {
    "returns": returns_table,
    "seeds": seeds_table,
    "improvement": improvement_table,
    "gap": gap_table,
    "reward": reward_table,
    "cost": cost_table,
    "convergence": _convergence,
    "curves": _curves,
    "intervals": _intervals,
    "provenance": provenance,
}
"""What an item may be: functions of results, ``rows`` and the item's options, which give nothing
where there are no results. A figure's options have its ``file`` besides."""


SECTIONS: Mapping[str, Callable[[Path, list[str]], dict[str, str]]] = {
    "benchmarks": lambda results, names: benchmark_parts(results / "benchmarks", names),
    "own_tasks": lambda results, names: own_task_parts(results / "own_tasks", names),
    "transfer": lambda results, names: transfer_parts(results / "transfer", names),
    "health": lambda results, names: health_parts(results / "health", names),
    "rounding": rounding_parts,
}
"""Sections of ``docs/pages.yaml`` beside ``pages``: parts by name, of files of other kinds."""


# --- pages -------------------------------------------------------------------------------------


def generate(root: Path) -> Pages:
    """Everything that ``docs/pages.yaml`` asks for, from the files below ``results``.

    Raises:
        ValueError: a wrong specification or result; says where.
    """
    values = plain(OmegaConf.load(root / "docs/pages.yaml"))  # type: ignore[arg-type]
    pages, labels = Pages(), row_labels() | values.get("labels", {})
    tables = {name: _read_table(root, name) for name in values["tables"]}
    for page, parts in values["pages"].items():
        pages.parts[page] = {}
        for part, items in parts.items():
            try:
                pages.parts[page][part] = _part(items, tables, labels, page, pages.figures)
            except (ValueError, TypeError) as error:
                raise ValueError(f"{page}, part {part!r}: {error}") from error
    for section, parts_of in SECTIONS.items():
        for page, names in values.get(section, {}).items():
            pages.parts.setdefault(page, {}).update(parts_of(root / "results", names))
    return pages


def row_labels() -> dict[str, str]:
    """What the rows of all tables are called, by name."""
    tables = (read_table(name) for name in table_names())
    return {name: row.label for table in tables for name, row in table.rows.items()}


def _read_table(root: Path, table: str) -> list[Result]:
    results = read_all(root / "results" / table)
    if any(result.table != table for result in results):
        tables = sorted({result.table for result in results})
        raise ValueError(f"results/{table} holds results of tables {tables}; expected {table!r}")
    return results


def _part(
    items: Sequence[Mapping[str, Any]],
    tables: Mapping[str, Sequence[Result]],
    labels: Mapping[str, str],
    page: str,
    figures: dict[str, Drawing],
) -> str:
    """The text of a part: its items, and which of their rows and columns have no results."""
    texts: list[str] = []
    absent: dict[str, None] = {}
    for item in (typed(Item, value) for value in items):
        _check(item, tables)
        results, options = tables[item.table], _options(item)
        names = _expand(item.rows or list(options.get("stages", ())), results)
        rows = {name: labels.get(name, name) for name in names}
        absent |= {label: None for name, label in rows.items() if not by_seed(results, name)}
        absent |= dict.fromkeys(_unmeasured(results, rows, options.get("columns", ())))
        file = options.pop("file", "")
        made = KINDS[item.kind](results, rows=rows, **options)
        if isinstance(made, partial):
            figures[file] = made
            texts.append(f"![{item.caption}]({os.path.relpath(file, Path(page).parent)})\n")
        elif made:
            texts.append("\n\n".join(text for text in (item.caption, made) if text))
        elif item.caption:
            texts.append(f"No results yet: {item.caption}\n")
    if absent:
        texts.append(f"No results yet: {'; '.join(absent)}.\n")
    return "\n".join(texts)


def _unmeasured(results: Sequence[Result], rows: Rows, columns: Sequence[Column]) -> list[str]:
    """Headings of the columns in which none of the rows that have results has a score."""
    found = {c.heading: any(scores_of(results, row, c) for row in rows) for c in columns}
    ran = any(by_seed(results, row) for row in rows)
    return [heading for heading, measured in found.items() if ran and not measured]


def _check(item: Item, tables: Mapping[str, Any]) -> None:
    for name, legal in (("kind", KINDS), ("table", tables)):
        if getattr(item, name) not in legal:
            got = getattr(item, name)
            raise ValueError(f"{name} is {got!r}, expected one of {', '.join(legal)}")


def _options(item: Item) -> dict[str, Any]:
    options = dict(item.options)
    if "column" in options:
        options["column"] = typed(Column, options["column"])
    if "columns" in options:
        options["columns"] = [typed(Column, column) for column in options["columns"]]
    return options


def _expand(patterns: Sequence[str], results: Sequence[Result]) -> list[str]:
    names = sorted({result.row for result in results})
    rows: dict[str, None] = {}
    for pattern in patterns:
        wild = any(character in pattern for character in "*?[")
        rows |= dict.fromkeys(fnfilter(names, pattern) if wild else [pattern])
    return list(rows)


def insert(text: str, parts: Mapping[str, str], page: str) -> str:
    """Put each part between its markers.

    Raises:
        ValueError: the page's pairs of markers are not those of the parts, each once.
    """
    pattern = re.compile(r"(<!-- (\w+):begin -->\n).*?(<!-- \2:end -->)", re.DOTALL)
    found = [match[2] for match in pattern.finditer(text)]
    if sorted(found) != sorted(parts):
        raise ValueError(f"{page} has markers of {found}; expected, each once, {list(parts)}")
    return pattern.sub(lambda match: match[1] + parts[match[2]] + match[3], text)


def stale(root: Path, pages: Pages) -> list[str]:
    """What does not agree with the results files: pages, and figures that are missing."""
    wrong = [f"{file} is missing" for file in pages.figures if not (root / file).exists()]
    for page, parts in pages.parts.items():
        text = (root / page).read_text(encoding="utf-8")
        if insert(text, parts, page) != text:
            wrong.append(f"{page} is not what the results files give")
    return wrong


def write(root: Path, pages: Pages) -> None:
    """Write parts into their pages, and the figures."""
    for page, parts in pages.parts.items():
        text = insert((root / page).read_text(encoding="utf-8"), parts, page)
        with atomic_path(root / page) as temporary:
            temporary.write_text(text, encoding="utf-8")
    for file, draw in pages.figures.items():
        save_figure(draw(), root / file)


def main(arguments: Sequence[str]) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser("pemirl report", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--root", type=Path, default=CHECKOUT, help="of the repository")
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--write", action="store_true", help="into the pages, and draw figures")
    action.add_argument("--check", action="store_true", help="fail if a page is out of date")
    given = parser.parse_args(arguments)
    if not (given.root / "docs/pages.yaml").is_file():
        parser.error(f"{given.root} is no checkout of the repository: it has no docs/pages.yaml")
    pages = generate(given.root)
    if given.write:
        write(given.root, pages)
    elif given.check:
        wrong = stale(given.root, pages)
        if wrong:
            sys.exit("\n".join([*wrong, "pemirl report --write mends that"]))
    else:
        for page, parts in pages.parts.items():
            for part, text in parts.items():
                sys.stdout.write(f"--- {page}: {part}\n{text}\n")
