"""Figures that compare rows draw the statistics of the results they were given."""

import numpy as np
import pytest

from pemirl_lab.pages.comparison import curve_band, interval_plot, stage_curves
from pemirl_lab.pages.tables import Column
from pemirl_lab.results import Result, Score

COLUMN = Column(setting="one_shot", variant="left", paper={"airl": (-18.0, 3.0), "gone": (-2, 1)})
ROWS = {"pemirl": "PEMIRL", "airl": "AIRL", "gone": "Gone", "absent": "Absent"}


def result(row, seed, mean, curves=None):
    score = Score(
        setting="one_shot",
        variant="left",
        goals="all",
        per_task=(mean,),
        random=-45.0,
        expert=-5.0,
        env_steps={"meta_training": 1, "adaptation": 0},
    )
    return Result(
        table="t", row=row, task="t", seed=seed, split="test", scores=(score,),
        curves=curves or {}, seconds={}, config={}, versions={}, hardware={}, commit="abc",
    )  # fmt: skip


def test_the_band_is_the_mean_with_its_interval_where_all_seeds_have_data():
    offsets = [-100.0, 0.0, 1.0, 5.0]
    curves = [[[0, 0.0 + o], [10, 10.0 + o], [20, 20.0 + o]] for o in offsets]
    curves[0] = [[5, -95.0], [30, -70.0]]  # the same line, sampled elsewhere
    x, (estimate, low, high) = curve_band(curves)
    assert (x[0], x[-1]) == (5, 20)
    assert np.allclose(estimate, x - 23.5)
    half = 3.1824 * np.std(offsets, ddof=1) / 2  # Student's t of four
    assert np.allclose(low, estimate - half, atol=1e-3)
    assert np.allclose(high, estimate + half, atol=1e-3)


def test_the_band_of_one_seed_is_its_curve():
    x, band = curve_band([[[0, 1.0], [2, 3.0]]])
    assert np.allclose(band, x + 1)


@pytest.mark.parametrize("curves", [[], [[]], [[[0, 1.0], [1, 1.0]], [[2, 1.0], [3, 1.0]]]])
def test_curves_that_cannot_be_aggregated_are_refused(curves):
    with pytest.raises(ValueError, match="expected one or more that share a range"):
        curve_band(curves)


def test_one_line_and_band_per_stage_with_references():
    found = [
        result("pemirl", seed, -7, {"pemirl": [[0, -40.0], [10, -7.0 - seed]]}) for seed in (0, 1)
    ]
    found.append(result("airl", 0, -18))
    stages = {"PEMIRL": ("pemirl", "pemirl"), "AIRL": ("airl", "airl")}
    axes = stage_curves(found, stages, references={"expert": -5.0}).axes[0]
    line, expert = axes.lines
    assert line.get_xydata()[-1] == pytest.approx((10, -7.5))
    band = axes.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == pytest.approx(
        (-40, -7.5 + 12.7062 * 0.5), abs=1e-3
    )
    assert list(expert.get_ydata()) == [-5.0, -5.0]
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["PEMIRL (2 seeds)", "expert (-5.00)"]
    with pytest.raises(ValueError, match=r"no curve of .*results have \[\('pemirl', 'pemirl'\)\]"):
        stage_curves(found, {"AIRL": ("airl", "airl")})


def test_intervals_seeds_paper_and_expert():
    found = [result("pemirl", seed, mean) for seed, mean in enumerate([-9.0, -7.0, -5.0])]
    found.append(result("airl", 0, -20.0))
    axes = interval_plot(found, COLUMN, ROWS).axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["PEMIRL", "AIRL", "Gone"]
    points = {
        marker: [tuple(p) for line in axes.lines if line.get_marker() == marker
                 for p in line.get_xydata()]
        for marker in "oD"
    }  # fmt: skip
    assert points["o"] == [(-9, 0), (-7, 0), (-5, 0), (-20, 1)]
    assert points["D"] == [(-18, 1), (-2, 2)]
    interval, estimate = (line.get_xdata() for line in axes.lines[:2])
    assert list(interval) == pytest.approx([-7 - 4.9683, -7 + 4.9683], abs=1e-3)  # Student's t
    assert list(estimate) == [-7, -7]
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["paper", "expert (-5.00)"]
    with pytest.raises(ValueError, match=r"no score of .*in rows \['gone'\]"):
        interval_plot(found, COLUMN, {"gone": "Gone"})
