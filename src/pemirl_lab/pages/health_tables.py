"""Tables of the signs of failure, and of where they appear (``results/health``)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pemirl_lab.pages.tables import markdown_table
from pemirl_trl.health import SIGNS, Finding, Health

Record = Mapping[str, Any]
"""What ``benchmarks/health_signs.py`` wrote of a case."""


def judged(record: Record) -> list[Finding]:
    """The findings of a case, by the thresholds of now."""
    health = Health()
    for iteration, row in record["rows"]:
        health.update(row, iteration)
    return health.findings


def _signs(folder: Path) -> str:
    heading = ["sign", "what it means", "measured", "a sign", "metrics", "cure"]
    rows = [
        [
            f"**{sign.name}**",
            sign.meaning,
            sign.measured,
            f"{sign.limit}, {sign.patience} iterations in a row",
            ", ".join(f"`{name}`" for name in sign.reads if "/" in name),
            sign.cure,
        ]
        for sign in SIGNS
    ]
    return markdown_table(heading, rows)


def _cases(folder: Path) -> str:
    records = [json.loads(file.read_text("utf-8")) for file in sorted(folder.glob("*.json"))]
    if not records:
        raise ValueError(f"{folder} holds no results: benchmarks/health_signs.py writes them")
    records.sort(key=lambda record: bool(record["expected"]))
    heading = ["training", "stage", "iterations", "expected", "said"]
    return markdown_table(heading, [_line(record) for record in records])


def _line(record: Record) -> list[str]:
    said = ", ".join(_short(finding) for finding in judged(record))
    expected = ", ".join(record["expected"])
    count = str(len(record["rows"]))
    return [record["label"], record["stage"], count, expected or "none", said or "none"]


def _short(finding: Finding) -> str:
    until = "the end" if finding.until is None else finding.until
    return f"{finding.sign.name} ({finding.since} to {until})"


PARTS: Mapping[str, Callable[[Path], str]] = {"signs": _signs, "cases": _cases}
"""By the name of the part of a page."""


def health_parts(folder: Path, names: Sequence[str]) -> dict[str, str]:
    """The parts of a page, of the cases in ``folder``.

    Raises:
        ValueError: an unknown name, or no cases.
    """
    if unknown := sorted(set(names) - set(PARTS)):
        raise ValueError(f"health tables {unknown}; expected some of {sorted(PARTS)}")
    return {name: PARTS[name](folder) for name in names}
