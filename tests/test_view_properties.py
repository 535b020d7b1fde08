"""`gcnd.view` of any meshes: a page that holds them and fetches nothing, or a refusal and no page."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from gcnd.viewer.changes import Figures
from view_cases import (
    FACES,
    LIFTED,
    SQUARE,
    Page,
    Shown,
    asked,
    elements,
    folder_of_a_page,
    manifest_of,
    shown,
    some,
    values_of,
)

Points = NDArray[np.float64]

LARGEST = 1e150
"""Coordinates beyond it are refused."""

HALF_A_STEP = 0.5001 / 65534
"""Of the largest value: what 16 bits leave out."""

numbers = st.one_of(
    st.floats(-1.0, 1.0),
    st.floats(),
    st.sampled_from([0.0, -0.0, 5e-324, 1e-310, 1e-200, 1e-160, 1e77, 1e150, 1.1e150, np.inf, np.nan]),
)
powers = st.sampled_from([None, None, *np.geomspace(1e-320, 1e150, 20)])


class Drawn(NamedTuple):
    """What `gcnd.view` is asked."""

    before: tuple[Points, Any]
    after: tuple[Points, Any]
    truth: tuple[Points, Any] | None
    confidence: list[float] | None

    @property
    def meshes(self) -> list[tuple[Points, Any]]:
        return [mesh for mesh in (self.before, self.after, self.truth) if mesh is not None]

    @property
    def is_allowed(self) -> bool:
        faces = self.before[1]
        return all(
            bool((np.abs(vertices) <= LARGEST).all())
            and len(vertices) == len(self.before[0])
            and own == faces
            and max(map(max, own)) < len(vertices)
            for vertices, own in self.meshes
        ) and (
            self.confidence is None
            or (len(self.confidence) == len(faces) and all(0 <= value <= 1 for value in self.confidence))
        )


@st.composite
def positions(draw: st.DrawFn, n: int) -> Points:
    """Of any size, and of sizes that differ by any power; most are finite."""
    scale = draw(powers)
    drawn = numbers if scale is None else st.one_of(st.floats(-1.0, 1.0), st.sampled_from([0.0, 1e-9, 0.5]))
    points = np.array(draw(st.lists(st.tuples(drawn, drawn, drawn), min_size=n, max_size=n)))
    if scale is not None:
        return points * scale
    return points if draw(st.integers(0, 5)) == 0 else np.clip(np.nan_to_num(points), -LARGEST, LARGEST)


@st.composite
def questions(draw: st.DrawFn) -> Drawn:
    n = draw(st.integers(1, 6))
    corners = st.tuples(*[st.integers(0, n - 1)] * 3)
    faces = draw(st.lists(corners, min_size=1, max_size=6))
    meshes: list[Any] = [(draw(positions(n)), faces) for _ in range(draw(st.integers(2, 3)))]
    if draw(st.booleans()):  # moved a little, as by denoising
        step = draw(st.sampled_from([0.0, 1e-12, 0.1])) * np.abs(meshes[0][0])
        with np.errstate(over="ignore", invalid="ignore"):
            meshes[1] = (meshes[0][0] + step * draw(positions(n)).clip(-1, 1), faces)
    if draw(st.integers(0, 7)) == 0:
        which = draw(st.integers(0, len(meshes) - 1))
        more = draw(st.lists(st.tuples(*[st.integers(0, n)] * 3), min_size=1, max_size=6))
        meshes[which] = (draw(positions(n + draw(st.integers(0, 1)))), more)
    sure = st.one_of(st.floats(0.0, 1.0), st.just(1.0))
    confidence = draw(st.one_of(st.none(), st.lists(sure, min_size=len(faces), max_size=len(faces))))
    if draw(st.integers(0, 9)) == 0:
        confidence = draw(st.lists(st.floats(), min_size=1, max_size=7))
    return Drawn(meshes[0], meshes[1], meshes[2] if len(meshes) > 2 else None, confidence)


# --- what a page has to hold, computed another way ---------------------------------------------------


def distances(ends: Points, others: Points) -> Points:
    return np.array([math.dist(a, b) for a, b in zip(ends, others, strict=True)])


def grain(length: float) -> float:
    """How coarse numbers of that size are: of the smallest there are, few tell lengths apart."""
    return 4 * 5e-324 / length if length else 0.0


def placed(meshes: list[Points]) -> tuple[list[Points], float]:
    """Around the middle of all, in units of the radius; and how far rounding may take them."""
    together = np.concatenate(meshes)
    low, high = together.min(axis=0), together.max(axis=0)
    middle = low + (high - low) / 2
    radius = distances(together, np.broadcast_to(middle, together.shape)).max() or 1.0
    return [(own - middle) / radius for own in meshes], 1e-6 + grain(radius)


def extent_of(points: Points) -> float:
    return float(np.abs(points).max())


def edges_of(points: Points, faces: Any) -> Points:
    pairs = {
        (min(p), max(p)) for f in faces for p in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0])) if p[0] != p[1]
    }
    return np.array([math.dist(points[a], points[b]) for a, b in sorted(pairs)])


def normal_of(corners: Points, extent: float) -> Points | None:
    """Of unit length; None of a face that is nearly a line, or too small beside its mesh to be sure of."""
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    if min(np.abs(a).max(), np.abs(b).max()) <= 1e-100 * extent:
        return None
    a, b = a / np.abs(a).max(), b / np.abs(b).max()
    cross = np.cross(a / np.linalg.norm(a), b / np.linalg.norm(b))
    sine = np.linalg.norm(cross)
    if sine <= 1e-6:
        return None
    normal: Points = cross / sine
    return normal


def check_angles(got: Points, first: Points, second: Points, faces: Any) -> None:
    for face, value in zip(faces, got, strict=True):
        corners = list(face)
        used = np.unique(faces)
        pair = [normal_of(own[corners], extent_of(own[used])) for own in (first, second)]
        if pair[0] is not None and pair[1] is not None:
            sine = np.linalg.norm(np.cross(pair[0], pair[1]))
            angle = math.degrees(math.atan2(sine, float(pair[0] @ pair[1])))
            assert value == pytest.approx(angle, abs=0.01)


def check_displacements(page: Page, layer: dict[str, Any], figures: Figures, drawn: Drawn) -> None:
    used = np.unique(drawn.before[1])
    before, after = (mesh[0][used] for mesh in (drawn.before, drawn.after))
    edges, got = edges_of(drawn.before[0], drawn.before[1]), values_of(page, layer, "before")
    assert len(got) == len(used) == figures.vertices
    if len(edges) and edges.min() > 1e-100 * extent_of(before):
        assert figures.mean_edge_length == pytest.approx(edges.mean(), rel=1e-9, abs=1e-322)
    if figures.mean_edge_length == 0.0:
        assert np.isnan(got).all()
        return
    with np.errstate(over="ignore"):
        expected = distances(before, after) / figures.mean_edge_length
    is_told = ~np.isnan(got)
    # What is left out is no number, or next to one.
    assert (expected[~is_told] > 1e299).all()
    close = (1e-9 + grain(figures.mean_edge_length)) * (1.0 + expected[is_told])
    assert (np.abs(got - expected)[is_told] <= HALF_A_STEP * layer["top"] + close).all()


def check_figures(page: Shown, figures: Figures, layers: dict[str, dict[str, Any]]) -> None:
    """Figures are those of the values in the page, and what there is not is a dash."""

    def check(
        mean: float, largest: float | None, flipped: int | None, layer: str, when: str = "before"
    ) -> None:
        values, top = values_of(page, layers[layer], when), layers[layer]["top"]
        known = values[~np.isnan(values)]
        close = 2 * HALF_A_STEP * top
        assert math.isnan(mean) == (len(known) == 0)
        if len(known):
            assert mean == pytest.approx(known.mean(), abs=close)
            assert largest is None or largest == pytest.approx(known.max(), abs=close)
        else:
            assert largest is None or math.isnan(largest)
        if flipped is not None:
            assert np.count_nonzero(known > 90 + close) <= flipped <= np.count_nonzero(known > 90 - close)

    check(figures.displacement_mean, figures.displacement_max, None, "displacement")
    check(figures.angle_mean, figures.angle_max, figures.flipped, "angle")
    if "error" in layers:
        assert figures.e_a_before is not None
        assert figures.e_a_after is not None
        check(figures.e_a_before, None, figures.flipped_before, "error", "before")
        check(figures.e_a_after, None, figures.flipped_after, "error", "after")
    told = [value for value in asdict(figures).values() if value is not None]
    assert not any(math.isinf(value) for value in told)
    assert sum(cell == "–" for cell in page.cells) == sum(math.isnan(value) for value in told)
    assert not any(word in cell for cell in page.cells for word in ("nan", "inf", "None"))


def check_page(text: bytes, figures: Figures, drawn: Drawn) -> None:
    page = shown(text)
    assert page.elements == elements(
        has_truth=drawn.truth is not None, n_layers=len(manifest_of(page)["layers"])
    )
    assert page.links == ["data:,"]
    assert page.policy.startswith("default-src 'none'; ")
    assert "http" not in page.policy
    manifest, faces = manifest_of(page), drawn.before[1]
    used = np.unique(faces)
    assert (manifest["faces"], manifest["vertices"]) == (len(faces), len(used))
    assert np.array_equal(page.array("faces", "<u4").reshape(-1, 3), np.searchsorted(used, faces))
    ends = [mesh[0][used] for mesh in (drawn.before, drawn.after)]
    places, close = placed(ends)
    for when, expected in zip(("before", "after"), places, strict=True):
        got = page.array(f"positions-{when}", "<f4").reshape(-1, 3)
        assert np.abs(got - expected).max() < close
    layers = {layer["name"]: layer for layer in manifest["layers"]}
    assert list(layers) == [
        name
        for name, is_there in (
            ("angle", True),
            ("error", drawn.truth is not None),
            ("displacement", True),
            ("doubt", drawn.confidence is not None),
        )
        if is_there
    ]
    for layer in layers.values():
        assert layer["top"] > 0
        assert layer["scaleEnd"] > 0
        unknown = [np.isnan(values_of(page, layer, when)).any() for when in ("before", "after")]
        assert layer["hasUnknown"] == any(unknown)
    check_displacements(page, layers["displacement"], figures, drawn)
    check_angles(values_of(page, layers["angle"], "before"), drawn.before[0], drawn.after[0], faces)
    if drawn.truth is not None:
        for when, mesh in (("before", drawn.before), ("after", drawn.after)):
            check_angles(values_of(page, layers["error"], when), mesh[0], drawn.truth[0], faces)
    if drawn.confidence is not None:
        doubt = 100 * (1 - np.array(drawn.confidence))
        assert np.abs(values_of(page, layers["doubt"], "before") - doubt).max() <= 100 * HALF_A_STEP
    check_figures(page, figures, layers)


# --- any meshes --------------------------------------------------------------------------------------


TINY = (1e-200 * SQUARE, FACES.tolist()), (1e-200 * LIFTED, FACES.tolist())
HUGE = (1e150 * SQUARE, FACES.tolist())
POINT = (0 * SQUARE, FACES.tolist())


@some
@given(questions())
@example(Drawn(TINY[0], TINY[1], TINY[0], None))
@example(Drawn(POINT, (LIFTED, FACES.tolist()), None, [0.0, 1.0]))
@example(Drawn(HUGE, (HUGE[0] + [0, 0, 5e-174], FACES.tolist()), None, None))
@example(Drawn(TINY[0], (1e150 * LIFTED, FACES.tolist()), None, None))
def test_any_meshes_give_a_whole_page_or_none(drawn: Drawn) -> None:
    before = [(vertices.tobytes(), list(faces)) for vertices, faces in drawn.meshes]
    with folder_of_a_page(former=b"former") as out:
        figures, refusal = asked(
            drawn.after, against=drawn.before, truth=drawn.truth, confidence=drawn.confidence, out=out
        )
        assert drawn.is_allowed == (refusal is None), refusal
        if figures is None:
            assert str(refusal)
            assert out.read_bytes() == b"former"
        else:
            check_page(out.read_bytes(), figures, drawn)
        assert [path.name for path in out.parent.iterdir()] == [out.name]
    assert [(vertices.tobytes(), list(faces)) for vertices, faces in drawn.meshes] == before


ANYTHING = st.one_of(
    st.none(),
    st.text(max_size=5),
    st.lists(st.one_of(st.floats(), st.text(max_size=2), st.lists(st.floats(0, 1), max_size=2)), max_size=3),
    arrays.arrays(
        st.sampled_from([np.float32, np.int64, np.bool_, np.complex128, "U2", "S2", "M8[s]", "O"]),
        arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3),
    ),
)


@pytest.mark.filterwarnings("ignore::gcnd.MeshWarning")
@settings(some, max_examples=80)
@given(ANYTHING)
@example(["", "a"])
@example([1j, 1j])
def test_any_confidence_is_one_or_is_refused(confidence: Any) -> None:
    with folder_of_a_page() as out:
        _, refusal = asked((LIFTED, FACES), against=(SQUARE, FACES), confidence=confidence, out=out)
        if refusal is not None:
            assert "confidence" in str(refusal)
            assert not out.exists()
        else:
            page = shown(out.read_bytes())
            layers = {layer["name"]: layer for layer in manifest_of(page)["layers"]}
            assert ("doubt" in layers) == (confidence is not None)
            if confidence is not None:
                sure = np.asarray(confidence, dtype=np.float64).ravel()
                assert np.allclose(values_of(page, layers["doubt"], "before"), 100 * (1 - sure), atol=0.01)
