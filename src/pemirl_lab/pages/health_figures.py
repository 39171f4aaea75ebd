"""The metrics of a stage as small panels, with the iterations that showed a sign of failure."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pemirl_trl.health import Finding
from pemirl_trl.methods.loop import Metrics

PANELS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("true return (no learner sees it)", ("return/true",)),
    ("learned return", ("return/learned", "best/return")),
    ("imitation loss", ("meta_il/loss_imitation",)),
    ("discriminator: accuracy", ("accuracy", "accuracy_expert", "accuracy_policy")),
    ("discriminator: loss, nats", ("loss_discriminator", "loss_expert", "loss_policy")),
    ("mean |r|, nats", ("reward/magnitude",)),
    ("q(m | demonstration), nats", ("context/information", "context/kl", "meta_il/kl")),
    ("log q(m | rollout), nats", ("log_q",)),
    ("spread explained by m", ("context/in_reward", "context/in_return")),
    ("policy: deviation", ("policy/scale", "policy/learned_scale")),
    ("policy: step accepted", ("trpo/accepted",)),
    ("policy: KL of the step, nats", ("trpo/kl",)),
    ("steps far outside", ("outside/share", "outside/rewarded")),
)
"""Titles, and metrics by their names, or by the last part where several methods have it."""

_COLUMNS = 3
_COLOURS = ("#0072b2", "#d55e00", "#009e73")  # Okabe and Ito
_SICK = "#d55e00"


def metric_panels(rows: Sequence[tuple[int, Metrics]], findings: Sequence[Finding]) -> Figure:
    """Draw each panel that the rows have metrics for, over iterations.

    Where a sign was present, the panels of the metrics that it reads are shaded, with its name and
    its threshold.

    Args:
        rows: iterations with their metrics.
        findings: of the same stage.

    Raises:
        ValueError: no row has a metric of a panel.
    """
    known = {name for _, row in rows for name in row}
    panels = [(title, _present(names, known)) for title, names in PANELS]
    panels = [(title, names) for title, names in panels if names]
    if not panels:
        raise ValueError(f"got metrics {sorted(known)}; expected some of those of {PANELS}")
    lines = -(-len(panels) // _COLUMNS)
    figure = Figure(figsize=(3.6 * _COLUMNS, 2.2 * lines + 0.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(lines, _COLUMNS, squeeze=False)
    for axes, (title, names) in zip(grid.flat, panels, strict=False):
        _draw(axes, title, names, rows)
        _shade(axes, names, findings, rows[-1][0])
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    for axes in grid.flat[max(0, len(panels) - _COLUMNS) : len(panels)]:
        axes.set_xlabel("iteration", fontsize=8)
    return figure


def _present(names: Sequence[str], known: set[str]) -> list[str]:
    """The metrics that are there; a name without a slash is that of any method."""
    found = []
    for name in names:
        same = [k for k in sorted(known) if k == name or ("/" not in name and _last(k) == name)]
        found += same
    return found


def _last(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _draw(
    axes: Axes, title: str, names: Sequence[str], rows: Sequence[tuple[int, Metrics]]
) -> None:
    for name, colour in zip(names, _COLOURS, strict=False):
        points = [(i, row[name]) for i, row in rows if name in row]
        marker = "o" if len(points) == 1 else ""
        axes.plot(*zip(*points, strict=True), marker, color=colour, linewidth=1.3, label=name)
        if len(points) > 1:
            axes.lines[-1].set_linestyle("-")
    axes.set_title(title, fontsize=9)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    if len(names) > 1:
        axes.legend(frameon=False, fontsize=7)


def _shade(axes: Axes, names: Sequence[str], findings: Sequence[Finding], last: int) -> None:
    for finding in findings:
        if not set(finding.sign.reads) & set(names):
            continue
        until = last if finding.until is None else finding.until
        axes.axvspan(finding.since - 0.5, until + 0.5, color=_SICK, alpha=0.15, linewidth=0)
        axes.text(
            *(0.02, 0.03),
            f"{finding.sign.name} ({finding.sign.limit})",
            color=_SICK,
            fontsize=7,
            transform=axes.transAxes,
        )
