"""Figures that compare rows of results over seeds; matplotlib's object interface, as in figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from numpy.typing import NDArray

from pemirl_lab.pages.tables import Column, Rows, by_seed, scores_of
from pemirl_lab.results import Result
from pemirl_trl.evaluation.statistics import seeds_interval

__all__ = ["curve_band", "interval_plot", "stage_curves"]

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito
_REFERENCE_STYLES = ("--", ":", "-.")
_POINTS = 60  # of a band; each is a bootstrap of its own
_RESAMPLES = 1000  # enough for the eye

Array = NDArray[np.float64]


def curve_band(curves: Sequence[Sequence[Sequence[float]]]) -> tuple[Array, Array]:
    """The mean over seeds (of ten and more: their IQM) with its pointwise 95 % interval.

    Args:
        curves: ``(x, y)`` pairs of each seed, x increasing; interpolated where their x differ.

    Returns:
        x ``[P]`` over the range that all seeds share, and ``(estimate, low, high)`` ``[3, P]``; the
        ends are the estimate for a single seed.

    Raises:
        ValueError: no curve, an empty one, or curves that share no range of x.
    """
    runs = [np.asarray(curve, np.float64).reshape(-1, 2).T for curve in curves]
    ranges = [(float(x[0]), float(x[-1])) for x, _ in runs if x.size]
    low, high = max((r[0] for r in ranges), default=1.0), min((r[1] for r in ranges), default=0.0)
    if len(ranges) != len(runs) or low > high:
        raise ValueError(f"got curves over {ranges}; expected one or more that share a range")
    x = np.linspace(low, high, _POINTS)
    values = np.stack([np.interp(x, *run) for run in runs])  # [seeds, P]
    band = np.array([seeds_interval(at, resamples=_RESAMPLES) for at in values.T]).T
    return x, np.where(np.isnan(band), band[0], band)


def stage_curves(
    results: Sequence[Result],
    stages: Mapping[str, tuple[str, str]],
    *,
    references: Mapping[str, float] | None = None,
    ylabel: str = "true return",
    title: str = "",
) -> Figure:
    """Learning curves over seeds: their mean or IQM, and its interval as a band.

    Args:
        results: of one comparison.
        stages: label to ``(row, stage)``, the name of a curve in ``Result.curves``; one line each.
            Those without a curve are left out.
        references: name to return, such as the expert's; dashed.
        ylabel: label of y.
        title: above the axes.

    Raises:
        ValueError: no result has any of the curves.
    """
    found = {}
    for label, (row, stage) in stages.items():
        curves = [r.curves[stage] for r in by_seed(results, row).values() if r.curves.get(stage)]
        if curves:
            found[label] = curves
    if not found:
        known = sorted({(r.row, stage) for r in results for stage in r.curves})
        raise ValueError(f"no curve of {list(stages.values())}; results have {known}")
    figure, axes = _canvas((6.4, 3.8))
    for index, (label, curves) in enumerate(found.items()):
        x, (estimate, low, high) = curve_band(curves)
        colour = _COLOURS[index % len(_COLOURS)]
        count = f"{len(curves)} seed{'s' if len(curves) > 1 else ''}"
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(x, estimate, color=colour, linewidth=2, label=f"{label} ({count})")
    for index, (name, value) in enumerate((references or {}).items()):
        style, text = _REFERENCE_STYLES[index % len(_REFERENCE_STYLES)], f"{name} ({value:.2f})"
        axes.axhline(value, color="0.35", linewidth=1, linestyle=style, label=text)
    axes.set(xlabel="environment steps", ylabel=ylabel, title=title)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 3M rather than 3e6
    axes.legend(facecolor="white", edgecolor="none", fontsize=9)
    return figure


def interval_plot(
    results: Sequence[Result], column: Column, rows: Rows, *, title: str = ""
) -> Figure:
    """Mean or IQM of each row with its 95 % interval, every seed, paper and expert.

    Args:
        results: of one comparison.
        column: what was measured; its paper's values are diamonds.
        rows: which, and their names, from the top; those without a value are left out.
        title: above the axes.

    Raises:
        ValueError: no row has a score in the column.
    """
    scores = {row: list(scores_of(results, row, column).values()) for row in rows}
    shown = [row for row in rows if scores[row] or (row in column.paper and any(scores.values()))]
    if not shown:
        raise ValueError(f"no score of {column.heading!r} in rows {list(rows)}")
    figure, axes = _canvas((6.8, 0.36 * len(shown) + 1.4))
    for y, row in enumerate(shown):
        colour = _COLOURS[y % len(_COLOURS)]
        if scores[row]:
            means = [score.mean for score in scores[row]]
            estimate, low, high = seeds_interval(means)
            if math.isfinite(low):
                axes.plot([low, high], [y, y], color=colour, linewidth=7, alpha=0.35, zorder=2)
            axes.plot([estimate] * 2, [y - 0.28, y + 0.28], color=colour, linewidth=2.5, zorder=3)
            axes.plot(means, [y] * len(means), "o", color=colour, markersize=4, zorder=4)
        if row in column.paper:
            label = None if axes.get_legend_handles_labels()[1] else "paper"
            paper = column.paper[row][0]
            axes.plot(paper, y, "D", color="white", markeredgecolor="black", label=label, zorder=5)
    expert = next(score.expert for of_row in scores.values() for score in of_row)
    axes.axvline(expert, color="0.35", linewidth=1, linestyle="--", label=f"expert ({expert:.2f})")
    axes.set_yticks(range(len(shown)), labels=[rows[row] for row in shown])
    axes.set(xlabel="true return", ylim=(len(shown) - 0.5, -0.5))
    figure.suptitle(title, fontsize=11)  # centred on the figure: long labels shift the axes
    axes.legend(facecolor="white", edgecolor="none", fontsize=9)
    return figure


def _canvas(size: tuple[float, float]) -> tuple[Figure, Axes]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes
