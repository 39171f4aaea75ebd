"""Which components may be read under dynamics that were not seen (``results/transfer``)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from pemirl_lab.pages.tables import interval_text, markdown_table
from pemirl_trl.evaluation.statistics import seeds_interval

__all__ = ["transfer_parts"]

POLICIES = {
    "adapted": "adapted",
    "carried_over": "policy carried over",
    "known": "best known",
    "random": "random",
}


def transfer_parts(root: Path, names: Sequence[str]) -> dict[str, str]:
    """The tables of families of bodies, by the name of their folder below ``root``.

    Raises:
        ValueError: a folder without results.
    """
    return {name: _table(root / name) for name in names}


def _table(folder: Path) -> str:
    files = sorted(folder.glob("*.json"))
    results = [json.loads(file.read_text("utf-8")) for file in files]
    if not results:
        raise ValueError(f"{folder} holds no results *.json")
    return _policies(results) if "gap_closed" in results[0] else _components(results)


def _policies(results: Sequence[Mapping[str, Any]]) -> str:
    """What policies reach that were trained on r, by what r reads and how many demonstrated."""
    heading = ["r reads", "bodies", "seeds", "gap closed", *POLICIES.values()]
    heading += ["task in m, R²", "body in m, R²"]
    groups: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for result in results:
        groups.setdefault((result["reads"], result["bodies"]), []).append(result)
    lines = []
    for (reads, bodies), runs in sorted(
        groups.items(), key=lambda item: (item[0][0] == "found", item[0][1])
    ):
        components = sorted({", ".join(run["read"]) for run in runs})
        means = [fmean(run["returns"][name]["true"] for run in runs) for name in POLICIES]
        told = [_mean(runs, "task"), _mean(runs, "body")]
        lines.append(
            [
                "the whole state" if reads == "whole" else "found: " + "; or ".join(components),
                str(bodies),
                str(len(runs)),
                interval_text(seeds_interval([run["gap_closed"] for run in runs]), 3)
                if len(runs) > 1
                else f"{runs[0]['gap_closed']:.3f}",
                *(f"{mean:.1f}" for mean in means),
                *told,
            ]
        )
    return markdown_table(heading, lines)


def _mean(runs: Sequence[Mapping[str, Any]], what: str) -> str:
    values = [run["contexts"][what] for run in runs if what in run["contexts"]]
    return f"{fmean(values):.2f}" if values else "–"


def _components(results: Sequence[Mapping[str, Any]]) -> str:
    """For each number of bodies the two best components, by their worst body, over seeds."""
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
