"""A page that holds all it shows, and shows what it was given."""

import base64
import re

import pytest
from matplotlib.figure import Figure

from pemirl_lab.pages import html
from pemirl_lab.pages.figures import measures_of_tasks

PNG = bytes.fromhex("89504e470d0a1a0a")


def drawn():
    figure = Figure(figsize=(1, 1))
    figure.subplots().plot([0, 1], [1, 0])
    return figure


def test_a_figure_is_inside_and_always_the_same():
    picture = html.figure(drawn(), "<a> & b")
    content = base64.b64decode(re.search(r"base64,([^\"]+)", picture)[1])
    assert content.startswith(PNG)
    assert picture == html.figure(drawn(), "<a> & b")
    assert "&lt;a&gt; &amp; b</figcaption>" in picture


def test_what_users_named_is_text_and_not_markup(tmp_path):
    evil = "<script>alert(1)</script>"
    parts = [
        html.paragraph(f"`{evil}` and {evil}"),
        html.section(evil, [html.table([evil], [[evil]]), html.facts({evil: evil})]),
    ]
    html.write_page(tmp_path / "page.html", evil, parts)
    page = (tmp_path / "page.html").read_text("utf-8")
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 9
    assert "<code>&lt;script&gt;" in page


def test_every_task_is_a_dot():
    figure = measures_of_tasks({"EPIC": {"r on a": [0.1, 0.2, 0.6], "r on b": [0.3]}})
    (axes,) = figure.axes
    dots, mean, single, _ = (line.get_ydata() for line in axes.get_lines())
    assert list(dots) == [0.1, 0.2, 0.6]
    assert list(mean) == pytest.approx([0.3, 0.3])
    assert list(single) == [0.3]


@pytest.mark.parametrize("nothing", [{}, {"EPIC": {}}])
def test_no_measures_are_refused(nothing):
    with pytest.raises(ValueError, match="expected some"):
        measures_of_tasks(nothing)
