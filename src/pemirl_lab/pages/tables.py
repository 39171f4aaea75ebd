"""Markdown tables of results: named configurations down, what was measured across.

Every table takes the results of one comparison (one ``table`` and ``split`` of
:class:`~pemirl_lab.results.Result`), shows a measured number as what its seeds say
together with a 95 % interval (:func:`~pemirl_trl.evaluation.seeds_interval`; none for one seed),
what was not measured as "–", and is empty where no row has results.
"""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field

from pydantic.dataclasses import dataclass

from pemirl_lab.results import Result, Score, normalised_return
from pemirl_trl.configuration import CHECKED
from pemirl_trl.evaluation.statistics import (
    Interval,
    probability_of_improvement,
    seeds_interval,
)

__all__ = [
    "Column",
    "by_seed",
    "cost_table",
    "improvement_table",
    "interval_text",
    "markdown_table",
    "millions",
    "parse_markdown_table",
    "provenance",
    "returns_table",
    "reward_table",
    "scores_of",
    "seeds_table",
]

MISSING = "–"
_SHORT = re.compile("(?<=^[0-9a-f]{12})[0-9a-f]+")  # what a commit is cut by
Rows = Mapping[str, str]
"""Rows of a table, in order, and what they are called in it."""


@dataclass(frozen=True, kw_only=True, config=CHECKED)
class Column:
    """What is measured, and what a paper says of it.

    Args:
        setting, variant, goals: of the :class:`~pemirl_lab.results.Score`.
        label: heading; made of the three by default.
        paper: published ``(mean, standard deviation)`` by row, also of ``expert`` and ``random``.
    """

    setting: str
    variant: str
    goals: str = "all"
    label: str = ""
    paper: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def heading(self) -> str:
        """The label, or what stands in for it."""
        setting = self.setting.replace("_", " ")
        return self.label or f"{setting}, {self.variant}, goals: {self.goals}"


# --- what the results hold ---------------------------------------------------------------------


def by_seed(results: Sequence[Result], row: str) -> dict[int, Result]:
    """Results of a row, by seed in increasing order.

    Raises:
        ValueError: two results of one row and seed, or results of more than one comparison.
    """
    kinds = sorted({(result.table, result.split) for result in results})
    if len(kinds) > 1:
        raise ValueError(f"got results of (table, split) {kinds}; expected those of one")
    found: dict[int, Result] = {}
    for result in sorted((r for r in results if r.row == row), key=lambda r: r.seed):
        if result.seed in found:
            raise ValueError(f"two results for row {row!r}, seed {result.seed}; expected one")
        found[result.seed] = result
    return found


def scores_of(results: Sequence[Result], row: str, column: Column) -> dict[int, Score]:
    """Scores of a row in a column, by seed, of the seeds that have one."""
    key = (column.setting, column.variant, column.goals)
    scores = {seed: result.score(*key) for seed, result in by_seed(results, row).items()}
    return {seed: score for seed, score in scores.items() if score is not None}


# --- tables ------------------------------------------------------------------------------------


def returns_table(
    results: Sequence[Result], columns: Sequence[Column] = (), rows: Rows | None = None
) -> str:
    """True returns: ``estimate [interval] (normalised)``, beside a paper's where a column has it.

    A row or column without results is shown only for the paper's sake. The first two lines are the
    expert and the random policy on the same tasks.

    Args:
        results: of one comparison.
        columns: what to show; by default everything that was measured.
        rows: which, and their names; by default all that there are.

    Raises:
        ValueError: see :func:`by_seed`.
    """
    rows = _all_rows(results) if rows is None else rows
    columns = [
        column
        for column in columns or _measured(results)
        if column.paper or any(scores_of(results, row, column) for row in rows)
    ]
    if not any(by_seed(results, row) for row in rows):
        return ""
    lines = []
    for name in ("expert", "random"):
        cells = [_reference_cell(results, rows, column, name) for column in columns]
        lines.append([name, "", *_with_paper(columns, cells, name)])
    for row, label in rows.items():
        seeds = len(by_seed(results, row))
        if seeds or any(row in column.paper for column in columns):
            cells = [_return_cell(scores_of(results, row, column), seeds) for column in columns]
            lines.append([label, str(seeds or MISSING), *_with_paper(columns, cells, row)])
    headings = [
        heading for c in columns for heading in (c.heading, *(["paper"] if c.paper else []))
    ]
    return markdown_table(["", "seeds", *headings], lines)


def seeds_table(results: Sequence[Result], columns: Sequence[Column], rows: Rows) -> str:
    """Every seed's mean return, and the worst: nothing hides behind an aggregate."""
    seeds = sorted({seed for row in rows for seed in by_seed(results, row)})
    lines = []
    for row, label in rows.items():
        for column in columns:
            means = {s: score.mean for s, score in scores_of(results, row, column).items()}
            if means:
                cells = [f"{means[s]:z.2f}" if s in means else MISSING for s in seeds]
                lines.append([label, column.heading, f"{min(means.values()):z.2f}", *cells])
    return markdown_table(["", "measured", "worst", *(f"seed {seed}" for seed in seeds)], lines)


def improvement_table(results: Sequence[Result], column: Column, baseline: str, rows: Rows) -> str:
    """How often, by how much and on which seeds the other rows are better than a baseline.

    ``P(better)`` takes the seeds of both as independent
    (:func:`~pemirl_trl.evaluation.statistics.probability_of_improvement`). The difference is taken
    seed by seed, for runs of one seed may share demonstrations and networks: what the seeds say
    together, and on how many of those that are shared it is above zero.

    Raises:
        ValueError: the baseline is none of the rows.
    """
    if baseline not in rows:
        raise ValueError(f"baseline is {baseline!r}, expected one of {', '.join(rows)}")
    base = {seed: score.mean for seed, score in scores_of(results, baseline, column).items()}
    lines = []
    for row, label in rows.items():
        means = {seed: score.mean for seed, score in scores_of(results, row, column).items()}
        if row == baseline or not means or not base:
            continue
        differences = [means[seed] - base[seed] for seed in means if seed in base]
        chance = probability_of_improvement(list(means.values()), list(base.values()))
        cells = [MISSING, MISSING]
        if differences:
            above = sum(difference > 0 for difference in differences)
            cells = [interval_text(seeds_interval(differences)), f"{above} of {len(differences)}"]
        lines.append([label, interval_text(chance), *cells])
    chance_heading = f"P(better than {rows[baseline]})"
    heading = [column.heading, chance_heading, "difference by seed", "better on seeds"]
    return markdown_table(heading, lines)


def reward_table(results: Sequence[Result], measures: Mapping[str, str], rows: Rows) -> str:
    """Measures of the learned reward, over seeds.

    Args:
        results: of one comparison.
        measures: names in ``Result.reward``, and their headings.
        rows: which, and their names; those without a learned reward are left out.
    """
    lines = []
    for row, label in rows.items():
        rewards = [r.reward for r in by_seed(results, row).values() if r.reward]
        if rewards:
            found = ([r[name] for r in rewards if name in r] for name in measures)
            cells = [interval_text(seeds_interval(v), 3) if v else MISSING for v in found]
            lines.append([label, str(len(rewards)), *cells])
    return markdown_table(["", "seeds", *measures.values()], lines)


def cost_table(results: Sequence[Result], rows: Rows) -> str:
    """Environment steps and wall-clock minutes of a run; the median over seeds, with the range."""
    lines = []
    for row, label in rows.items():
        runs = list(by_seed(results, row).values())
        if runs:
            steps = [
                [float(max(score.env_steps[name] for score in run.scores)) for run in runs]
                for name in ("meta_training", "adaptation")
            ]
            minutes = [math.fsum(run.seconds.values()) / 60 for run in runs]
            spread = f" ({min(minutes):.1f} to {max(minutes):.1f})" if len(runs) > 1 else ""
            cells = [millions(statistics.median(counts)) for counts in steps]
            cells.append(f"{statistics.median(minutes):.1f}{spread}")
            lines.append([label, str(len(runs)), *cells])
    heading = ["", "seeds", "steps of meta-training", "steps of one adaptation", "minutes of a run"]
    return markdown_table(heading, lines)


def provenance(results: Sequence[Result], rows: Rows) -> str:
    """One line: which seeds, tasks, machines, versions and commits the results come from."""
    chosen = [result for result in results if result.row in rows]

    def distinct(values: Iterable[object]) -> str:
        return ", ".join(sorted({str(value) for value in values}))

    if not chosen:
        return ""
    seeds = ", ".join(map(str, sorted({result.seed for result in chosen})))
    facts = [
        f"{len(chosen)} runs, seeds {seeds}",
        f"tasks: {distinct(r.split for r in chosen)}",
        distinct(f"{r.hardware.get('cpus')} CPUs ({r.hardware.get('cpu')})" for r in chosen),
        *(
            f"{package} {distinct(r.versions.get(package, 'unknown') for r in chosen)}"
            for package in ("torch", "torchrl", "mujoco")
        ),
        f"commit {distinct(_SHORT.sub('', r.commit) for r in chosen)}",
    ]
    return "; ".join(facts) + ".\n"


def markdown_table(heading: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table in Markdown, whose cells may hold bars; empty without lines."""
    if not lines:
        return ""
    table = [heading, ["---"] * len(heading), *lines]
    escaped = ((cell.replace("|", r"\|") for cell in line) for line in table)
    return "".join(f"| {' | '.join(line)} |\n" for line in escaped)


def parse_markdown_table(text: str) -> list[list[str]]:
    """The cells of :func:`markdown_table`, the heading first; empty where there is no table."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    cells = [re.split(r"(?<!\\) \| ", line[2:-2]) for line in lines]
    return [[cell.replace(r"\|", "|") for cell in line] for line in cells[:1] + cells[2:]]


def millions(steps: float) -> str:
    """Environment steps, such as ``1.73M``; ``never`` if infinite."""
    if math.isinf(steps):
        return "never"
    return f"{steps / 1e6:.2f}M" if steps else "0"


# --- cells -------------------------------------------------------------------------------------


def interval_text(interval: Interval, digits: int = 2) -> str:
    """``estimate [low, high]``; the estimate alone where there is no interval."""
    estimate, low, high = (f"{value:z.{digits}f}" for value in interval)
    return estimate if math.isnan(interval.low) else f"{estimate} [{low}, {high}]"


def _return_cell(scores: Mapping[int, Score], seeds: int) -> str:
    if not scores:
        return MISSING
    normalised = seeds_interval([score.normalised for score in scores.values()]).estimate
    few = f", {len(scores)} of {seeds} seeds" if len(scores) < seeds else ""
    interval = seeds_interval([score.mean for score in scores.values()])
    return f"{interval_text(interval)} ({normalised:z.3f}{few})"


def _paper_cell(paper: Mapping[str, Sequence[float]], row: str) -> str:
    if row not in paper:
        return MISSING
    mean, deviation = paper[row]
    text = f"{mean:z.2f} ± {deviation:.2f}"
    if row in ("expert", "random") or not {"expert", "random"} <= set(paper):
        return text
    return f"{text} ({normalised_return(mean, paper['random'][0], paper['expert'][0]):z.3f})"


def _with_paper(columns: Sequence[Column], cells: Sequence[str], row: str) -> list[str]:
    """Each column's cell, and the paper's beside it where the column has one."""
    line = []
    for column, cell in zip(columns, cells, strict=True):
        line += [cell, _paper_cell(column.paper, row)] if column.paper else [cell]
    return line


def _reference_cell(results: Sequence[Result], rows: Rows, column: Column, name: str) -> str:
    """The expert's or the random policy's return; a range where runs measured different ones."""
    scores = [score for row in rows for score in scores_of(results, row, column).values()]
    found = sorted({f"{getattr(score, name):z.2f}" for score in scores}, key=float)
    return " to ".join(dict.fromkeys((found[0], found[-1]))) if found else MISSING


def _measured(results: Sequence[Result]) -> list[Column]:
    scores = [score for result in results for score in result.scores]
    keys = dict.fromkeys((score.setting, score.variant, score.goals) for score in scores)
    return [Column(setting=s, variant=variant, goals=goals) for s, variant, goals in keys]


def _all_rows(results: Sequence[Result]) -> dict[str, str]:
    return {row: row for row in sorted({result.row for result in results})}
