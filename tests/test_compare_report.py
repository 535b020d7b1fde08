"""Means and the best of several, and what is written: CSV, JSON and a page that stands alone."""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from browser import find_browser, running_browser
from compare_cases import ball, case, method, moved
from gcnd import _geom
from gcnd.compare.charts import bar_chart, time_chart
from gcnd.compare.finish import finish
from gcnd.compare.pictures import choose_view, draw_case, scale_end
from gcnd.compare.rows import INPUT, Row
from gcnd.compare.run import Conditions
from gcnd.compare.summary import ALL, summarise, with_best
from gcnd.formats.atomic import write_atomic_npz
from gcnd.picture import Panel, save_panels, view_matrix


def row(method: str, e_a: float | None, **values: Any) -> Row:
    fixed = {
        "key": f"{method}-{values.get('mesh', 'a')}-{values.get('level', '0.1')}",
        "mesh": "a",
        "kind": "cad",
        "noise": "gaussian",
        "level": "0.1",
        "faces": 1000,
        "family": method.partition("[")[0],
        "source": "gcnd",
        "version": "1",
        "settings": {"x": 1},
        "error": "went <wrong>" if e_a is None else None,
        "seconds": None if e_a is None or method == INPUT else 0.5,
    }
    return Row(**{**fixed, **values, "method": method, "e_a": e_a})


ROWS = [
    row(INPUT, 20.0, flipped=10, volume_change=-0.5),
    row("g[s=1]", 3.0, flipped=2, displacement_max=1.0),
    row("g[s=2]", 2.0, flipped=1, displacement_max=2.0),
    row("l0", 4.0, volume_change=-3.0),
    row("lost", None),
    row(INPUT, 30.0, mesh="b", kind="smooth", faces=3000),
    row("g[s=1]", 5.0, mesh="b", kind="smooth", faces=3000, seconds=1.5),
    row("g[s=2]", 6.0, mesh="b", kind="smooth", faces=3000),
    row("l0", 4.5, mesh="b", kind="smooth", faces=3000, volume_change=1.0),
    row("lost", 9.0, mesh="b", kind="smooth", faces=3000),
]


def test_the_best_is_chosen_on_each_mesh() -> None:
    best = with_best(ROWS, ["g[s=1]", "g[s=2]", "l0"])[len(ROWS) :]
    assert [(b.method, b.mesh, b.e_a, b.chosen) for b in best] == [
        ("g, best of 2", "a", 2.0, "g[s=2]"),
        ("g, best of 2", "b", 5.0, "g[s=1]"),
        ("best classical", "a", 2.0, "g[s=2]"),
        ("best classical", "b", 4.5, "l0"),
    ]
    assert with_best(ROWS[3:5], ["l0"]) == ROWS[3:5]
    failed = [row("g[s=1]", None), row("g[s=2]", None)]
    assert with_best(failed, [])[-1].error == "every member failed"


def test_a_truth_without_area_has_no_best_and_no_failure() -> None:
    flat = [row("g[s=1]", None), row("g[s=2]", None, error=None, seconds=2.0, e_v=1.0)]
    best = with_best(flat, [])[-1]
    assert (best.method, best.error, best.e_a, best.e_v) == ("g, best of 2", None, None, None)
    assert (best.seconds, best.chosen) == (None, None)


def test_means_by_kind_and_level() -> None:
    lines = {(x.kind, x.level, x.method): x for x in summarise(with_best(ROWS, []))}
    whole = lines[ALL, ALL, "g[s=1]"]
    assert (whole.runs, whole.failed, whole.e_a) == (2, 0, 4.0)
    assert whole.seconds_per_million == pytest.approx(1e6 * 2.0 / 4000)
    assert lines["cad", "0.1", "g[s=1]"].e_a == 3.0
    assert lines["cad", ALL, "g[s=1]"].flipped == pytest.approx(0.2)  # percent
    assert lines[ALL, ALL, "l0"].volume_change == 2.0  # of the amounts
    assert lines[ALL, ALL, "g, best of 2"].e_a == 3.5
    assert lines[ALL, ALL, "g, best of 2"].is_choice
    assert not whole.is_choice
    lost = lines[ALL, ALL, "lost"]
    assert (lost.runs, lost.failed, lost.e_a) == (2, 1, 9.0)
    none = lines["cad", ALL, "lost"]
    assert (none.failed, none.e_a, none.seconds_per_million) == (1, None, None)
    order = [x.method for x in summarise(ROWS) if (x.kind, x.level) == ("cad", "0.1")]
    assert order == [INPUT, "g[s=2]", "g[s=1]", "l0", "lost"]


def test_the_close_up_lies_where_faces_differ_and_are_seen() -> None:
    mesh = ball()
    centroids = _geom.face_geometry(mesh.truth, mesh.faces)[1]
    for direction in ([1.0, 0.6, 0.4], [-1.0, -0.5, -0.3]):
        near = np.linalg.norm(centroids - np.array(direction) / np.linalg.norm(direction), axis=1) < 0.25
        view = choose_view(mesh.truth, mesh.faces, near.astype(float))
        flat = centroids[near] @ view.matrix.T
        assert (flat[:, 2] > 0.5).all()  # towards the viewer
        inside = np.abs(flat[:, :2] - view.close[:2]) <= view.close[2]
        assert inside.all(axis=1).mean() > 0.6
        assert np.allclose(view.matrix @ view.matrix.T, np.eye(3))
        assert view.close[2] < 0.3 * view.whole[2]
    nothing = choose_view(mesh.truth, mesh.faces, np.zeros(len(mesh.faces)))
    assert np.array_equal(nothing.matrix, view_matrix(35.0, 25.0))


def test_the_scale_ends_at_a_round_number() -> None:
    assert scale_end([np.linspace(0, 10, 101)]) == 10
    assert scale_end([np.linspace(0, 10, 101), np.full(10, 29.0)]) == 30
    assert scale_end([np.full(10, 170.0)]) == 60


def pixels(uri: str) -> np.ndarray:
    head, _, data = uri.partition(",")
    assert head == "data:image/webp;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).astype(int)


def test_pictures_show_one_view_and_colour_the_error() -> None:
    mesh = ball()
    drawn = draw_case(mesh, {"clean": mesh.truth, "noisy again": mesh.noisy})
    noisy, clean, again, truth = drawn.shots
    assert [shot.title for shot in drawn.shots] == ["noisy", "clean", "noisy again", "truth"]
    assert noisy.whole == again.whole
    assert (clean.e_a, truth.e_a, truth.close_error) == (0.0, None, "")
    assert noisy.e_a == again.e_a > 5
    whole = [pixels(shot.whole) for shot in (clean, truth)]
    silhouettes = [(image < 250).any(axis=2) for image in whole]
    assert (silhouettes[0] == silhouettes[1]).mean() > 0.99
    disc = silhouettes[0].mean()
    assert disc == pytest.approx(np.pi / 4 / 1.04**2, rel=0.03)
    # No error is the dark violet at the foot of the scale; the noisy mesh has yellow and green in it.
    inside = whole[0][silhouettes[0]]
    assert inside[:, 1].mean() < 40
    assert pixels(noisy.whole)[silhouettes[0]][:, 1].mean() > 80


class References(HTMLParser):
    """Collects whatever a page would fetch, and its tags."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "srcset", "action", "data") and value:
                self.found.append(value)


def test_what_is_written_and_that_the_page_stands_alone(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    cases = [case("a", 0.1, "cad"), case("b", 0.1, "smooth")]
    rows = [one for one in ROWS if one.method in (INPUT, "l0", "lost")]
    for one in rows:
        if one.error is None:
            write_atomic_npz(tmp_path / "results" / f"{one.key}.npz", vertices=ball(0.1).truth.astype("f4"))
    methods = [method(moved, by=0.5)]
    options = {"dataset": "<data> & more", "threads": 1, **vars(Conditions(1))}
    lines = finish(tmp_path, options, cases, methods, rows, skipped=["skipped x: not there"])
    with (tmp_path / "results.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [(line["method"], line["e_a"], line["error"]) for line in table[:3]] == [
        (INPUT, "20.0", ""),
        ("l0", "4.0", ""),
        ("lost", "", "went <wrong>"),
    ]
    assert json.loads(table[1]["settings"]) == {"x": 1}
    whole = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert (whole["about"]["dataset"], whole["about"]["skipped"]) == (
        "<data> & more",
        ["skipped x: not there"],
    )
    assert len(whole["summary"]) == len(lines)
    assert [one["e_a"] for one in whole["rows"]] == [one.e_a for one in rows]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:", page, re.IGNORECASE)
    seen = References()
    seen.feed(page)
    assert all(value.startswith(("data:image/webp;base64,", "#")) for value in seen.found)
    assert not {"script", "link", "iframe"} & {*seen.tags}
    assert "@import" not in page
    assert page.count("<svg") == 2
    assert seen.tags.count("figure") == 7  # noisy, l0 and truth of both, and "lost" of b
    assert "&lt;data&gt; &amp; more" in page
    assert "went &lt;wrong&gt;" in page
    assert "skipped x: not there" in page
    assert not [path.name for path in tmp_path.iterdir() if path.name.endswith(".tmp")]


@pytest.mark.parametrize("name", [r"a$\frac$", "x$_1$_{", "网格"])
@pytest.mark.filterwarnings("error")
def test_names_stand_in_charts_as_they_are(name: str, tmp_path: Path) -> None:
    rows = [row(method, 3.0, kind=kind, level=name) for method in (INPUT, name) for kind in (name, "cad")]
    lines = summarise(rows)
    charts = [bar_chart(lines, "gaussian"), time_chart([line for line in lines if line.kind == ALL], [])]
    for chart in charts:
        assert name in html.unescape(chart)  # as text, or beside its outlines as a comment
    panel = Panel(name, ball().truth, ball().faces)
    if name.isascii():
        save_panels(tmp_path / "a.png", [[panel]])
        with Image.open(tmp_path / "a.png") as image:
            assert image.width > 100


@pytest.mark.skipif(find_browser() is None, reason="no Chromium is installed, and GCND_BROWSER names none")
def test_tables_scroll_where_the_screen_is_narrow(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    cases = [case("a", 0.1, "cad"), case("b", 0.1, "smooth")]
    finish(tmp_path, {"dataset": "d", "threads": 1}, cases, [method(moved, by=0.5)], ROWS, skipped=[])
    executable = find_browser()
    assert executable
    with running_browser(executable, tmp_path / "profile") as browser:
        for width in (360, 1280):
            browser.read(tmp_path / "report.html", width)
            wide = browser.evaluate("document.documentElement.scrollWidth")
            table = browser.evaluate("document.querySelector('table').scrollWidth")
            assert wide <= width
            assert table > 360
