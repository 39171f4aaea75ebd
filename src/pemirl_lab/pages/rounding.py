"""A published run, made again: what another order of sums, or another CPU, does to it."""

from __future__ import annotations

from pathlib import Path

from pemirl_lab.pages.tables import markdown_table
from pemirl_lab.results import Score, read, read_all

_SETTINGS = {
    "one_shot": "one-shot",
    "policy_generalisation": "policy carried over",
    "reward_adaptation": "reward adaptation",
}


def rounding_parts(results: Path, names: list[str]) -> dict[str, str]:
    """The parts of a page: true returns of a run as stored, and of the same run made again.

    Args:
        results: the folder of all results. ``benchmarks/rounding_TABLE.json`` is a run made again.
        names: of the tables.
    """
    return {f"rounding_{name}": rounding_table(results, name) for name in names}


def rounding_table(results: Path, table: str) -> str:
    """Stored and again, beside the range of all stored seeds of that row."""
    again = read(results / "benchmarks" / f"rounding_{table}.json")
    seeds = {result.seed: result for result in read_all(results / table / again.row)}
    stored = seeds[again.seed]

    def line(score: Score) -> list[str] | None:
        key = (score.setting, score.variant, score.goals)
        before, every = stored.score(*key), [seed.score(*key) for seed in seeds.values()]
        means = [found.mean for found in every if found is not None]
        if before is None or score.setting not in _SETTINGS:
            return None
        goals = [] if score.goals == "all" else [score.goals]
        return [
            ", ".join([_SETTINGS[score.setting], score.variant, *goals]),
            f"{before.mean:.3f}",
            f"{score.mean:.3f}",
            f"{min(means):.2f} to {max(means):.2f}",
        ]

    lines = [made for score in again.scores if (made := line(score)) is not None]
    heading = ["true return", "stored", "again", f"stored, all {len(seeds)} seeds"]
    cpus = f"Stored: {stored.hardware['cpu']}; again: {again.hardware['cpu']}."
    return f"{markdown_table(heading, lines)}\n{cpus}\n"
