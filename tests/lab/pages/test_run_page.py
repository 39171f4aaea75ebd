"""One HTML file of a run that holds all that it shows."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure

from pemirl_lab.cli import OTHERS
from pemirl_lab.pages.health_figures import PANELS, metric_panels
from pemirl_lab.pages.run_page import LARGEST_FILM, main, run_page
from pemirl_trl.health import SIGNS
from pemirl_trl.methods.health_log import HealthLog, replayed


class Balanced(HTMLParser):
    """Collects the text, the rows of tables and what does not close."""

    VOID = ("meta", "img", "br")

    def __init__(self):
        super().__init__()
        self.open, self.rows, self.text, self.links = [], [], "", []

    def handle_starttag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("src", "href")]
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append(0)
        if tag in ("td", "th"):
            self.rows[-1] += 1

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def parsed(page):
    parser = Balanced()
    parser.feed(page)
    assert parser.open == []
    return parser


@pytest.fixture
def run(tmp_path):
    """A folder as a run leaves it, with a stage that sickened."""
    record = {"task": "maze", "method": "robust", "seed": 3, "training": {"lr": 1e-3}}
    record["results"] = str(tmp_path / "results")
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(record))
    (tmp_path / "versions.json").write_text('{"versions": {"torch": "2"}}')
    (tmp_path / "seconds.json").write_text('{"robust": 90.0}')
    log = HealthLog("robust", tmp_path / "health/robust.json")
    for i in range(1, 21):
        log(i, {"reward/magnitude": 50.0 if i > 8 else 1.0, "return/learned": float(i)})
    log.save()
    (tmp_path / "figures").mkdir()
    figure = Figure(figsize=(1, 1))
    figure.subplots().imshow(np.eye(2))
    figure.savefig(tmp_path / "figures/reward_maps.png")
    (tmp_path / "film.mp4").write_bytes(b"film")
    return tmp_path


def test_it_shows_what_the_run_left(run):
    page = parsed(run_page(run))
    for text in ("maze · robust · seed 3", "r exploding", "9 to the end", "reward maps"):
        assert text in page.text
    for text in ("film.mp4", "training.lr", "versions.torch", "1.5"):
        assert text in page.text


def test_it_needs_nothing_from_elsewhere(run):
    page = run_page(run)
    links = parsed(page).links
    assert len(links) == 3  # curves, map, film
    assert all(link.startswith("data:") for link in links)
    assert "<script" not in page
    assert not re.search(r"url\(|@import", page)


def test_tables_have_as_many_cells_as_their_heading(run):
    rows = parsed(run_page(run)).rows
    health = rows[:2]
    assert health == [5, 5]


def test_what_is_said_is_escaped(run):
    record = yaml.safe_load((run / "config.yaml").read_text())
    (run / "config.yaml").write_text(yaml.safe_dump(record | {"task": "<b>&"}))
    assert "<b>&" in parsed(run_page(run)).text


def test_a_large_film_is_named_but_not_embedded(run):
    with (run / "film.mp4").open("wb") as film:
        film.truncate(LARGEST_FILM + 1)
    page = run_page(run)
    assert "too large" in page
    assert len(page) < LARGEST_FILM


def test_the_command(run, tmp_path, capsys):
    assert "run_page" in OTHERS
    main([f"run_dir={run}"])
    assert (run / "index.html").read_text().startswith("<!doctype html>")
    with pytest.raises(SystemExit, match="is no folder of a run"):
        main([f"run_dir={tmp_path / 'elsewhere'}"])
    with pytest.raises(SystemExit, match="missing run_dir="):
        main([])
    (run / "health/robust.json").write_text("[]")
    with pytest.raises(SystemExit, match="is damaged"):
        main([f"run_dir={run}"])


def test_panels_shade_the_sick_iterations_of_the_metric_that_a_sign_reads():
    rows = [(i, {"reward/magnitude": 50.0, "return/learned": 1.0}) for i in range(1, 11)]
    figure = metric_panels(rows, replayed(rows).findings)
    sick = {axes.get_title(): len(axes.patches) for axes in figure.axes if axes.get_title()}
    assert sick == {"learned return": 0, "mean |r|, nats": 1}
    with pytest.raises(ValueError, match="expected some of"):
        metric_panels([(1, {"else": 0.0})], [])


def test_every_sign_has_a_panel():
    shown = {name for _, names in PANELS for name in names}
    for sign in SIGNS:
        assert any(name in shown or name.split("/")[-1] in shown for name in sign.reads), sign.name
