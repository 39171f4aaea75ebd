"""Figures through matplotlib's object interface: no pyplot state, no display needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke
from matplotlib.ticker import EngFormatter
from numpy.typing import ArrayLike

from pemirl_trl.evaluation.reward_quality import Bounds
from pemirl_trl.files import atomic_path

__all__ = ["learning_curve", "measures_of_tasks", "reward_maps", "reward_scatter", "save_figure"]

_REFERENCE_STYLES = ("--", ":", "-.")
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito
_CURVE_POINTS = 200
_OUTLINE = [withStroke(linewidth=2.4, foreground="0.25")]
_SIDE = 2.2  # inches, the side of one map

Segment = tuple[tuple[float, float], tuple[float, float]]


def reward_maps(
    learned: ArrayLike,
    true: ArrayLike,
    extent: Bounds,
    goals: ArrayLike,
    *,
    shaped: ArrayLike | None = None,
    start: ArrayLike | None = None,
    segments: Sequence[Segment] = (),
    demonstrations: ArrayLike | None = None,
    titles: Sequence[str] | None = None,
) -> Figure:
    """Draw learned rewards above true ones, and shaped ones between, one column per context.

    The learned reward's scale is arbitrary, so every map spans its own range of colours.

    Args:
        learned: ``[C, H, W]``, row 0 at the lowest y.
        true: ``[C, H, W]``.
        extent: ``((x_low, x_high), (y_low, y_high))`` of the maps, in metres.
        goals: ``[C, 2]``, red stars.
        shaped: the learned reward with its potential, ``[C, H, W]``.
        start: ``[2]`` or ``[C, 2]``, white circles.
        segments: barriers ``((x0, y0), (x1, y1))``, thick black lines.
        demonstrations: positions ``[C, T, 2]`` of the demonstration that each context came from.
        titles: one per column.

    Raises:
        ValueError: the number of contexts or the shapes do not agree.
    """
    rows = {"learned reward": np.asarray(learned)}
    if shaped is not None:
        rows["shaped reward"] = np.asarray(shaped)
    rows["true reward"] = np.asarray(true)
    goals = np.asarray(goals)
    count = len(goals)
    paths = None if demonstrations is None else np.asarray(demonstrations)
    starts = None if start is None else np.broadcast_to(np.asarray(start), (count, 2))
    lengths = {
        **{name: maps.shape for name, maps in rows.items()},
        "goals": goals.shape,
        "demonstrations": (count,) if paths is None else paths.shape,
        "titles": (count,) if titles is None else (len(titles),),
    }
    if any(m.ndim != 3 for m in rows.values()) or any(s[0] != count for s in lengths.values()):
        raise ValueError(f"got shapes {lengths}; expected [C, H, W] maps and C of everything else")
    figure, grid = _map_grid(len(rows), count, extent)
    for row, (name, maps) in zip(grid, rows.items(), strict=True):
        images = [_draw_map(axes, values, extent) for axes, values in zip(row, maps, strict=True)]
        row[0].set_ylabel(name, fontsize=10)
        bar = figure.colorbar(images[-1], ax=list(row), fraction=0.04, pad=0.01)
        bar.set_ticks([maps[-1].min(), maps[-1].max()], labels=["low", "high"])
        bar.outline.set_visible(False)
    for column in range(count):
        for axes in grid[:, column]:
            if paths is not None:
                axes.plot(*paths[column].T, color="white", linewidth=1.2, path_effects=_OUTLINE)
            axes.add_collection(
                LineCollection(segments, colors="black", linewidths=5, capstyle="round")
            )
            _mark(axes, goals[column], None if starts is None else starts[column])
        if titles is not None:
            grid[0, column].set_title(titles[column], fontsize=9)
    return figure


def _map_grid(rows: int, columns: int, extent: Bounds) -> tuple[Figure, np.ndarray]:
    (x_low, x_high), (y_low, y_high) = extent
    height = _SIDE * (y_high - y_low) / (x_high - x_low)
    figure = Figure(figsize=(_SIDE * columns + 1.2, height * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)


def _draw_map(axes: Axes, values: np.ndarray, extent: Bounds) -> AxesImage:
    image = axes.imshow(
        values,
        origin="lower",
        extent=(*extent[0], *extent[1]),
        cmap="viridis",
        norm=Normalize(values.min(), values.max()),
        interpolation="bilinear",
    )
    axes.set(xlim=extent[0], ylim=extent[1], xticks=[], yticks=[])
    return image


def _mark(axes: Axes, goal: np.ndarray, start: np.ndarray | None) -> None:
    if start is not None:
        axes.plot(*start, "o", markersize=9, color="white", markeredgecolor="black", zorder=3)
    axes.plot(*goal, "*", markersize=15, color="red", markeredgecolor="white", zorder=4)


def reward_scatter(
    learned: Mapping[str, ArrayLike],
    true: Mapping[str, ArrayLike],
    titles: Sequence[str],
) -> Figure:
    """Draw the learned reward of transitions over their true one.

    Args:
        learned: coverage distribution (a column) to rewards ``[C, B]``.
        true: the same for the true reward.
        titles: what each of the C tasks (a colour) is called.

    Raises:
        ValueError: the distributions or shapes do not agree.
    """
    points = {name: (np.asarray(true.get(name, ())), np.asarray(learned[name])) for name in learned}
    shapes = {name: (x.shape, y.shape) for name, (x, y) in points.items()}
    if not points or any(x.shape != y.shape or len(x) != len(titles) for x, y in points.values()):
        raise ValueError(f"got shapes {shapes}; expected pairs of [{len(titles)}, B]")
    figure = Figure(figsize=(3.2 * len(points) + 0.4, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(points), squeeze=False, sharex=True, sharey=True)[0]
    for axes, (name, (x, y)) in zip(grid, points.items(), strict=True):
        for task, title in enumerate(titles):
            colour = _COLOURS[task % len(_COLOURS)]
            axes.plot(x[task], y[task], ".", color=colour, markersize=3, alpha=0.5, label=title)
        axes.set(title=name, xlabel="true reward")
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    grid[0].set_ylabel("learned reward")
    grid[-1].legend(frameon=False, fontsize=8, markerscale=3)
    return figure


def measures_of_tasks(measures: Mapping[str, Mapping[str, ArrayLike]]) -> Figure:
    """Draw each metric's value of every task, a column of dots per reward and coverage.

    Args:
        measures: metric (a panel) to what was measured (a column) to ``[C]``.

    Raises:
        ValueError: there is none.
    """
    if not measures or not all(measures.values()):
        raise ValueError(
            f"got measures { ({k: list(v) for k, v in measures.items()}) }; expected some"
        )
    figure = Figure(figsize=(3.2 * len(measures) + 0.4, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(measures), squeeze=False)[0]
    for axes, (metric, columns) in zip(grid, measures.items(), strict=True):
        for x, (name, values) in enumerate(columns.items()):
            values = np.asarray(values, float)
            spread = np.linspace(-0.2, 0.2, len(values)) if len(values) > 1 else np.zeros(1)
            colour = _COLOURS[x % len(_COLOURS)]
            axes.plot(x + spread, values, "o", color=colour, markersize=3, alpha=0.6, label=name)
            axes.plot([x - 0.3, x + 0.3], [values.mean()] * 2, color="black", linewidth=1.5)
        axes.set(title=metric)
        axes.set_xticks(range(len(columns)), list(columns), rotation=30, ha="right", fontsize=8)
        axes.grid(alpha=0.25, axis="y")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def learning_curve(
    series: Mapping[str, Sequence[tuple[ArrayLike, ArrayLike]]],
    *,
    references: Mapping[str, float] | None = None,
    xlabel: str = "environment steps",
    ylabel: str = "return",
    title: str = "",
) -> Figure:
    """Draw each method's mean over seeds, every seed as a thin line, and reference returns.

    Args:
        series: method to one ``(x [n], y [n])`` pair per seed, x increasing; the mean runs over
            the x that all seeds share.
        references: name to return, such as the expert's; dashed.
        xlabel: label of x.
        ylabel: label of y.
        title: above the axes.

    Raises:
        ValueError: a method without seeds, or x and y of different lengths.
    """
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for index, (name, seeds) in enumerate(series.items()):
        runs = [(np.asarray(x, float), np.asarray(y, float)) for x, y in seeds]
        if not runs or any(x.ndim != 1 or x.shape != y.shape or not x.size for x, y in runs):
            shapes = [(x.shape, y.shape) for x, y in runs]
            raise ValueError(f"{name!r} has runs of shapes {shapes}; expected ([n], [n]) per seed")
        colour = _COLOURS[index % len(_COLOURS)]
        for x, y in runs:
            axes.plot(x, y, color=colour, linewidth=0.8, alpha=0.35)
        shared = np.linspace(max(x[0] for x, _ in runs), min(x[-1] for x, _ in runs), _CURVE_POINTS)
        mean = np.mean([np.interp(shared, x, y) for x, y in runs], axis=0)
        label = f"{name} ({len(runs)} seed{'s' if len(runs) > 1 else ''})"
        axes.plot(shared, mean, color=colour, linewidth=2, label=label)
    for index, (name, value) in enumerate((references or {}).items()):
        style = _REFERENCE_STYLES[index % len(_REFERENCE_STYLES)]
        label = f"{name} ({value:.2f})"
        axes.axhline(value, color="0.35", linewidth=1, linestyle=style, label=label)
    axes.set(xlabel=xlabel, ylabel=ylabel, title=title)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 3M rather than 3e6
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9)
    return figure


def save_figure(figure: Figure, path: str | Path, dpi: int = 150) -> None:
    """Write ``figure`` atomically, in the format that the suffix of ``path`` names."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi)
