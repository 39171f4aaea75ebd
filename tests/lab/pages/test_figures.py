"""Figures draw the data they were given, at the right place."""

import sys

import numpy as np
import pytest

from pemirl_lab.pages.figures import (
    learning_curve,
    reward_maps,
    reward_scatter,
    save_figure,
)

EXTENT = ((-0.1, 0.5), (0.0, 0.3))
GOALS = np.array([[0.0, 0.2], [0.4, 0.1]])


def maps():
    return np.arange(2 * 3 * 4, dtype=float).reshape(2, 3, 4)


def drawn(axes, marker):
    return [
        tuple(np.ravel(line.get_xydata())) for line in axes.lines if line.get_marker() == marker
    ]


def test_maps_goals_starts_and_barriers_are_where_they_belong():
    figure = reward_maps(
        maps(),
        -maps(),
        EXTENT,
        GOALS,
        start=[0.2, 0.05],
        segments=[((-0.1, 0.15), (0.3, 0.15))],
        demonstrations=np.stack([np.linspace([0.2, 0.05], goal, 7) for goal in GOALS]),
        titles=["a", "b"],
    )
    panels = figure.axes[:4]  # then two colour bars
    for index, axes in enumerate(panels):
        row, column = divmod(index, 2)
        image = axes.images[0]
        assert np.array_equal(image.get_array(), (-1) ** row * maps()[column])
        assert (image.origin, image.get_extent()) == ("lower", [-0.1, 0.5, 0.0, 0.3])
        assert (image.norm.vmin, image.norm.vmax) == (
            image.get_array().min(),
            image.get_array().max(),
        )
        assert drawn(axes, "*") == [tuple(GOALS[column])]
        assert drawn(axes, "o") == [(0.2, 0.05)]
        path = next(line for line in axes.lines if len(line.get_xydata()) == 7)
        assert np.allclose(path.get_xydata()[-1], GOALS[column])
        assert np.allclose(axes.collections[0].get_segments(), [[(-0.1, 0.15), (0.3, 0.15)]])
    assert [axes.get_title() for axes in panels] == ["a", "b", "", ""]


def test_shaped_maps_stand_between_learned_and_true_ones():
    figure = reward_maps(maps(), -maps(), EXTENT, GOALS, shaped=2 * maps())
    panels = figure.axes[:6]
    assert [a.get_ylabel() for a in panels[::2]] == [
        "learned reward",
        "shaped reward",
        "true reward",
    ]
    for row, factor in enumerate((1, 2, -1)):
        for column in range(2):
            image = panels[2 * row + column].images[0].get_array()
            assert np.array_equal(image, factor * maps()[column])


def test_scatter_has_a_panel_per_coverage_and_a_colour_per_task():
    true = {"random": np.arange(6.0).reshape(2, 3), "expert": np.zeros((2, 5))}
    learned = {name: values - 1 for name, values in true.items()}
    figure = reward_scatter(learned, true, ["a", "b"])
    assert [axes.get_title() for axes in figure.axes] == ["random", "expert"]
    first, second = figure.axes[0].lines
    assert first.get_color() != second.get_color()
    assert np.array_equal(second.get_xydata(), [[3, 2], [4, 3], [5, 4]])


def test_scatter_refuses_what_does_not_agree():
    points = {"random": np.zeros((2, 3))}
    for learned, true, titles in ((points, {}, "ab"), (points, points, "a"), ({}, {}, "")):
        with pytest.raises(ValueError, match=r"expected pairs of \["):
            reward_scatter(learned, true, titles)


@pytest.mark.parametrize(
    "wrong",
    [
        {"shaped": maps()[:1]},
        {"learned": maps()[:1]},
        {"true": maps()[0]},
        {"titles": ["a"]},
        {"demonstrations": maps()[:1]},
    ],
)
def test_maps_refuse_what_does_not_agree(wrong):
    arguments = {"learned": maps(), "true": maps(), "extent": EXTENT, "goals": GOALS} | wrong
    with pytest.raises(ValueError, match=r"expected \[C, H, W\] maps"):
        reward_maps(**arguments)


def test_curve_is_the_mean_where_all_seeds_have_data():
    first = ([0, 10, 20], [0.0, 1.0, 2.0])
    second = ([5, 10, 30], [3.0, 4.0, 8.0])
    figure = learning_curve({"pemirl": [first, second]}, references={"expert": -5.0})
    one, two, mean, expert = figure.axes[0].lines
    assert np.array_equal(one.get_xydata(), np.transpose(first))
    assert np.array_equal(two.get_xydata(), np.transpose(second))
    x, y = mean.get_data()
    assert (x[0], x[-1]) == (5, 20)
    assert y[0] == pytest.approx((0.5 + 3) / 2)
    assert y[-1] == pytest.approx((2 + 6) / 2)
    assert list(expert.get_ydata()) == [-5.0, -5.0]
    legend = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert legend == ["pemirl (2 seeds)", "expert (-5.00)"]


@pytest.mark.parametrize("seeds", [[], [([0, 1], [0.0])], [([], [])]])
def test_curve_refuses_runs_without_data(seeds):
    with pytest.raises(ValueError, match="'pemirl' has runs of shapes"):
        learning_curve({"pemirl": seeds})


def test_saving_takes_the_format_from_the_suffix_and_leaves_one_file(tmp_path):
    figure = learning_curve({"a": [([0, 1], [0, 1])]})
    save_figure(figure, tmp_path / "a.png")
    save_figure(figure, tmp_path / "a.pdf")
    assert (tmp_path / "a.png").read_bytes()[1:4] == b"PNG"
    assert (tmp_path / "a.pdf").read_bytes()[:4] == b"%PDF"
    assert len(list(tmp_path.iterdir())) == 2


def test_no_pyplot_state_is_made():
    before = set(sys.modules)
    save = learning_curve({"a": [([0, 1], [0, 1])]})
    assert "matplotlib.pyplot" not in set(sys.modules) - before
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or save.number not in pyplot.get_fignums()
