"""The page of `gcnd view` in a real browser: what is drawn, and what each control changes about it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import gcnd
from browser import Browser, find_browser, running_browser
from gcnd.data.noise import add_noise

EXECUTABLE = find_browser()
pytestmark = pytest.mark.skipif(
    EXECUTABLE is None, reason="no Chromium is installed, and GCND_BROWSER names none"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    assert EXECUTABLE
    with running_browser(EXECUTABLE, tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noisy box against the true one; at the right, the result is a little off."""
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    for _ in range(3):
        box = box.subdivide()
    truth, faces = np.array(box.vertices), np.array(box.faces)
    noisy = add_noise(truth, faces.astype(np.uint32), level=0.3, seed=1)
    clean = truth + 0.05 * (noisy - truth)
    path = tmp_path_factory.mktemp("page") / "view.html"
    gcnd.view((clean, faces), against=(noisy, faces), truth=(truth, faces), out=path)
    return path


@pytest.fixture(scope="module")
def square(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A square made narrower: no face turns, and every vertex moves equally far."""
    vertices = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    path = tmp_path_factory.mktemp("square") / "view.html"
    faces = [[0, 1, 2], [0, 2, 3]]
    gcnd.view((vertices * [1, 0.5, 1], faces), against=(vertices, faces), out=path)
    return path


def differing(first: NDArray[Any], second: NDArray[Any]) -> float:
    """Fraction of the pixels that differ visibly."""
    return float(np.mean(np.abs(first - second).max(axis=2) > 12))


def drawn(picture: NDArray[Any]) -> NDArray[np.bool_]:
    """Pixels that show a mesh; the background is light and nearly grey."""
    is_background = (picture.min(axis=2) > 225) & (np.ptp(picture, axis=2) < 14)
    found: NDArray[np.bool_] = ~is_background
    return found


def roughness(picture: NDArray[Any]) -> float:
    """Mean difference of neighbouring pixels where the mesh is: noise makes facets, a box has flat sides."""
    inside = drawn(picture)
    step = np.abs(np.diff(picture.mean(axis=2), axis=1))
    return float(step[inside[:, 1:] & inside[:, :-1]].mean())


def halves(picture: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The left and the right half below the labels, without the line between them."""
    middle = picture.shape[1] // 2
    return picture[50:, : middle - 2], picture[50:, -(middle - 2) :]


def state(browser: Browser) -> str:
    return str(browser.evaluate("document.documentElement.dataset.state"))


def test_both_meshes_are_drawn_from_one_camera(browser: Browser, page: Path) -> None:
    browser.open(page)
    assert state(browser) == "ready"
    left, right = halves(browser.picture("#stage"))
    for half in (left, right):
        assert 0.15 < drawn(half).mean() < 0.9
        rows, columns = np.nonzero(drawn(half))
        # Nothing is cut off, and the mesh stands in the middle.
        assert 0 < columns.min() < half.shape[1] * 0.2
        assert half.shape[1] * 0.8 < columns.max() < half.shape[1] - 1
        assert abs((columns.min() + columns.max()) / half.shape[1] - 1) < 0.05
        assert abs((rows.min() + rows.max() + 100) / (half.shape[0] + 50) - 1) < 0.1
    # The same silhouette but for the noise on it, and another surface.
    assert np.mean(drawn(left) != drawn(right)) < 0.05
    assert differing(left, right) > 0.15
    assert roughness(left) > 2 * roughness(right)


def test_a_lopsided_mesh_stands_in_the_middle(browser: Browser, tmp_path: Path) -> None:
    corners = np.array([[0.0, 0, 0], [4, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = (corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    gcnd.view(mesh, against=mesh, out=tmp_path / "view.html")
    browser.open(tmp_path / "view.html")
    browser.click("input[value=blend]")
    browser.evaluate("document.querySelectorAll('.tag').forEach(tag => tag.remove())")
    picture = browser.picture("#canvas")
    places = np.nonzero(drawn(picture))
    middles = [(own.min() + own.max()) / size - 1 for own, size in zip(places, picture.shape, strict=False)]
    filled = [np.ptp(own) / size for own, size in zip(places, picture.shape, strict=False)]
    assert np.abs(middles).max() < 0.02
    assert max(filled) == pytest.approx(1 / 1.06, abs=0.01)


def test_the_page_says_nothing_and_fetches_nothing(browser: Browser, page: Path) -> None:
    browser.open(page)
    for layer in ("angle", "error", "displacement", ""):
        browser.set("#layer", layer)
    for view in ("wipe", "blend", "side"):
        browser.click(f"input[value={view}]")
    assert browser.complaints() == []
    assert browser.requests() == [page.as_uri()]


def test_the_policy_forbids_the_network(browser: Browser, page: Path) -> None:
    browser.open(page)
    answer = browser.evaluate("fetch('https://example.org/').then(() => 'fetched', e => e.message)")
    assert answer == "Failed to fetch"
    assert any("Content Security Policy" in complaint for complaint in browser.complaints())


@pytest.mark.parametrize("view", ["wipe", "blend"])
def test_the_slider_goes_from_one_mesh_to_the_other(browser: Browser, page: Path, view: str) -> None:
    browser.open(page)
    browser.click(f"input[value={view}]")
    pictures = {}
    for value in ("0", "0.5", "1"):
        browser.set("#slider", value, "input")
        pictures[value] = browser.picture("#canvas")
    assert differing(pictures["0"], pictures["1"]) > 0.1
    before, after = ("1", "0") if view == "wipe" else ("0", "1")
    assert roughness(pictures[before]) > 2 * roughness(pictures[after])
    between = roughness(pictures["0.5"])
    assert 1.2 * roughness(pictures[after]) < between < 0.9 * roughness(pictures[before])
    if view == "wipe":
        left, right = halves(pictures["0.5"])
        assert differing(left[:, :-8], halves(pictures[before])[0][:, :-8]) == 0.0
        assert differing(right[:, 8:], halves(pictures[after])[1][:, 8:]) == 0.0


def test_the_divider_can_be_dragged(browser: Browser, page: Path) -> None:
    browser.open(page)
    browser.click("input[value=wipe]")
    box = browser.evaluate(
        "(({x, y, width}) => [x, y, width])(document.querySelector('#stage').getBoundingClientRect())"
    )
    x, y, width = box
    browser.drag((x + width / 2, y + 200), (x + width / 4, y + 210))
    assert float(browser.evaluate("document.querySelector('#slider').value")) == pytest.approx(0.25, abs=0.01)
    # The view itself stayed.
    assert browser.evaluate("document.querySelector('#divider').style.left") == "25%"


def test_colours_stand_for_values(browser: Browser, page: Path) -> None:
    browser.open(page)
    plain = browser.picture("#stage")
    assert browser.evaluate("document.querySelector('#legend').hidden") is True
    browser.set("#layer", "error")
    left, right = halves(browser.picture("#stage"))
    legend = browser.evaluate("document.querySelector('#legend').innerText")
    assert "error against truth, degrees" in legend
    assert legend.rstrip().endswith("°")
    # The result is near the truth, which is violet; the noisy mesh goes up to yellow.
    yellow = [
        np.mean((half[..., 0] > 150) & (half[..., 1] > 140) & (half[..., 2] < 90)) for half in (left, right)
    ]
    violet = [np.mean((half[..., 1] < 60) & (half[..., 2] > half[..., 1] + 20)) for half in (left, right)]
    assert yellow[0] > 0.02
    assert yellow[1] == 0.0
    assert violet[1] > 5 * violet[0]
    # A change is one of both meshes, so it has the same colours on both.
    browser.set("#layer", "angle")
    both = halves(browser.picture("#stage"))
    yellow = [np.mean((half[..., 0] > 150) & (half[..., 1] > 140) & (half[..., 2] < 90)) for half in both]
    assert min(yellow) > 0.004
    browser.set("#layer", "")
    assert differing(browser.picture("#stage"), plain) == 0.0


def test_the_legend_says_in_what_its_numbers_are(browser: Browser, tmp_path: Path) -> None:
    vertices, faces = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), [[0, 1, 2], [0, 2, 3]]
    out = tmp_path / "view.html"
    gcnd.view((1.1 * vertices, faces), against=(vertices, faces), confidence=[0.5, 1.0], out=out)
    browser.open(out)
    for layer, unit in (("angle", "degrees"), ("displacement", "mean edges"), ("doubt", "percent")):
        browser.set("#layer", layer)
        title = browser.evaluate("document.querySelector('#legend-title').textContent")
        assert title.endswith(f", {unit}")


def test_the_scale_has_the_end_that_is_typed(browser: Browser, page: Path) -> None:
    browser.open(page)
    browser.set("#layer", "angle")
    narrow = browser.picture("#canvas")
    browser.set("#scale-end", "180")
    wide = browser.picture("#canvas")
    assert browser.evaluate("document.querySelector('#ticks').lastChild.textContent") == "180°"
    assert wide[drawn(wide)][:, 1].mean() < narrow[drawn(narrow)][:, 1].mean() - 15
    # What is no end of a scale changes nothing.
    browser.set("#scale-end", "-3")
    assert browser.evaluate("document.querySelector('#scale-end').value") == "180"
    assert differing(browser.picture("#canvas"), wide) == 0.0


def test_values_of_vertices_run_smoothly_and_those_of_faces_do_not(browser: Browser, tmp_path: Path) -> None:
    """One corner of two triangles is lifted: one face turns, and the displacement fades across it."""
    vertices, faces = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), [[0, 1, 2], [0, 2, 3]]
    gcnd.view(
        (vertices + np.outer([0, 1, 0, 0], [0, 0, 0.5]), faces),
        against=(vertices, faces),
        out=tmp_path / "view.html",
    )
    browser.open(tmp_path / "view.html")
    shares = {}
    for layer in ("angle", "displacement"):
        browser.set("#layer", layer)
        left, _ = halves(browser.picture("#canvas"))
        _, counts = np.unique(left[drawn(left)], axis=0, return_counts=True)
        shares[layer] = np.sort(counts)[::-1][:2] / counts.sum()
    assert shares["angle"].sum() > 0.95
    assert shares["angle"].min() > 0.3
    assert shares["displacement"][0] > 0.3
    assert shares["displacement"][1] < 0.05


def test_a_known_value_has_its_colour(browser: Browser, square: Path) -> None:
    """The middle of the scale is viridis at 0.5, (33, 145, 140), under the light of the view."""
    browser.open(square)
    browser.set("#layer", "displacement")
    top = float(browser.evaluate("JSON.parse(document.querySelector('#manifest').textContent).layers[1].top"))
    browser.set("#scale-end", str(2 * top))
    picture = browser.picture("#canvas")
    color = np.median(picture[drawn(picture)], axis=0)
    light = color[1] / 145
    assert 0.5 < light <= 1.0
    assert color == pytest.approx(np.array([33, 145, 140]) * light, abs=3)


def test_wires_can_be_shown(browser: Browser, page: Path) -> None:
    browser.open(page)
    plain = browser.picture("#canvas")
    browser.set("#wires", True)
    wired = browser.picture("#canvas")
    assert differing(plain, wired) > 0.05
    left, _ = halves(wired)
    assert np.mean(left.max(axis=2) < 70) > 2 * np.mean(halves(plain)[0].max(axis=2) < 70) + 0.01
    browser.set("#wires", False)
    assert differing(plain, browser.picture("#canvas")) == 0.0


def test_both_panes_turn_together_and_back(browser: Browser, page: Path) -> None:
    browser.open(page)
    first = browser.picture("#canvas")
    browser.drag((300, 500), (420, 470))
    turned = browser.picture("#canvas")
    for old, new in zip(halves(first), halves(turned), strict=True):
        assert differing(old, new) > 0.05
    left, right = halves(turned)
    assert np.mean(drawn(left) != drawn(right)) < 0.05
    browser.click("#reset")
    assert differing(first, browser.picture("#canvas")) == 0.0


def test_the_keys_do_what_the_page_says(browser: Browser, page: Path) -> None:
    browser.open(page)
    first = browser.picture("#canvas")
    browser.evaluate("document.querySelector('#canvas').focus({focusVisible: false})")
    for there, back in (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown"), ("+", "-")):
        browser.press(there)
        assert differing(first, browser.picture("#canvas")) > 0.02, there
        browser.press(back)
        assert differing(first, browser.picture("#canvas")) < 0.02, back
    browser.press("ArrowLeft")
    browser.press("0")
    assert differing(first[20:-20], browser.picture("#canvas")[20:-20]) < 0.002
    browser.press("w")
    assert browser.evaluate("document.querySelector('#wires').checked") is True
    seen = []
    for _ in range(4):
        browser.press("c")
        seen.append(browser.evaluate("document.querySelector('#layer').value"))
    assert seen == ["angle", "error", "displacement", ""]
    browser.press("2")
    assert browser.evaluate("document.querySelector('input[name=view]:checked').value") == "wipe"
    browser.press(".")
    assert float(browser.evaluate("document.querySelector('#slider').value")) == pytest.approx(0.55)
    browser.press(",")
    browser.press(",")
    assert float(browser.evaluate("document.querySelector('#slider').value")) == pytest.approx(0.45)


def test_up_can_be_y(browser: Browser, page: Path) -> None:
    browser.open(page)
    first = browser.picture("#canvas")
    browser.set("#up", "y")
    other = browser.picture("#canvas")
    assert differing(first, other) > 0.05
    assert 0.15 < drawn(halves(other)[0]).mean() < 0.9
    browser.set("#up", "z")
    assert differing(first, browser.picture("#canvas")) == 0.0


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (700, 900), (360, 740)])
def test_everything_fits(browser: Browser, page: Path, width: int, height: int) -> None:
    browser.open(page, width, height)
    browser.set("#layer", "displacement")
    browser.click("input[value=wipe]")
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    script = """[...document.querySelectorAll('#tools label, #tools button, #legend, #slider, .tag, aside table')]
        .map(e => e.getBoundingClientRect()).filter(r => r.width).map(r => [r.left, r.right])"""
    for left, right in browser.evaluate(script):
        assert left >= -9
        assert right <= width + 9
    overlaps = """(() => { const r = [...document.querySelectorAll('.tag')].map(e => e.getBoundingClientRect());
        return r[0].right > r[1].left && r[0].bottom > r[1].top; })()"""
    assert browser.evaluate(overlaps) is False
    assert 0.1 < drawn(browser.picture("#canvas")).mean() < 0.95


def test_narrow_panes_stand_one_above_the_other(browser: Browser, page: Path) -> None:
    browser.open(page, 400, 900)
    picture = browser.picture("#canvas")
    middle = picture.shape[0] // 2
    upper, lower = picture[40 : middle - 2], picture[middle + 40 :]
    for pane in (upper, lower):
        assert 0.15 < drawn(pane).mean() < 0.9
    assert roughness(upper) > 2 * roughness(lower)


def test_every_control_has_a_name(browser: Browser, page: Path) -> None:
    browser.open(page)
    browser.set("#layer", "angle")
    browser.click("input[value=wipe]")
    browser.call("Accessibility.enable")
    nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
    roles = {"radio", "combobox", "MenuListPopup", "spinbutton", "checkbox", "button", "slider", "image"}
    found = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in nodes
        if not node["ignored"] and node["role"]["value"] in roles - {"MenuListPopup"}
    ]
    assert {role for role, _ in found} >= {"radio", "combobox", "spinbutton", "checkbox", "button", "slider"}
    assert [entry for entry in found if not entry[1].strip()] == []


def test_a_damaged_page_says_so(browser: Browser, page: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "view.html"
    damaged.write_text(
        page.read_text(encoding="utf-8").replace('"faces": 768', '"faces": 769'), encoding="utf-8"
    )
    browser.open(damaged)
    assert state(browser) == "failed"
    said = browser.evaluate("document.querySelector('#trouble').innerText")
    assert "the meshes in this page are damaged" in said
    # The figures do not need the view.
    assert "768" in browser.evaluate("document.querySelector('aside').innerText")


def test_without_webgl_the_figures_stand(page: Path, tmp_path: Path) -> None:
    assert EXECUTABLE
    with running_browser(EXECUTABLE, tmp_path, "--disable-3d-apis") as without:
        without.open(page)
        assert state(without) == "failed"
        assert "WebGL 2" in without.evaluate("document.querySelector('#trouble').innerText")
        assert "768" in without.evaluate("document.querySelector('aside').innerText")
