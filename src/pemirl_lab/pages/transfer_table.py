"""Which components may be read under dynamics that were not seen (``results/transfer``)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pemirl_lab.pages.tables import interval_text, markdown_table
from pemirl_trl.evaluation.statistics import seeds_interval

__all__ = ["transfer_parts"]


def transfer_parts(root: Path, names: Sequence[str]) -> dict[str, str]:
    """The tables of families of bodies, by the name of their folder below ``root``.

    Raises:
        ValueError: a folder without results.
    """
    return {name: _table(root / name) for name in names}


def _table(folder: Path) -> str:
    """For each number of bodies the two best components, by their worst body, over seeds."""
    results = [json.loads(file.read_text("utf-8")) for file in sorted(folder.glob("seed*.json"))]
    if not results:
        raise ValueError(f"{folder} holds no results seed*.json")
    heading = ["bodies", "seeds", "best component", "nats", "second", "nats"]
    lines = [
        [count, str(len(results)), *_cells([result["families"][count] for result in results])]
        for count in results[0]["families"]
    ]
    return markdown_table(heading, lines)


def _cells(families: Sequence[Mapping[str, Mapping[str, Any]]]) -> list[str]:
    worst = {name: [family[name]["worst"] for family in families] for name in families[0]}
    ranked = sorted(worst, key=lambda name: -sum(worst[name]))[:2]
    return [
        cell for name in ranked for cell in (name, interval_text(seeds_interval(worst[name]), 3))
    ]
