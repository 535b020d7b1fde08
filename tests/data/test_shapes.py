"""Procedural shapes: closed, oriented, well shaped, true to their kind, the same again from the same seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gcnd.data.shape_cache import kind_sequence, load_shapes, shape_path
from gcnd.data.shapes import SHAPE_KINDS, Shape, ShapeKind, make_shape
from gcnd.data.shapes_cad import FAMILIES as CAD_FAMILIES
from gcnd.data.shapes_cad_edged import edge_cutter, edged_solid
from gcnd.data.shapes_decimate import decimated, subdivided_from_coarse
from gcnd.data.shapes_detail import RELIEFS
from gcnd.data.shapes_field import SmoothNoise, iso_surface
from gcnd.data.shapes_mesh import FACE_RANGE, edge_pairs, is_sound, subdivided, triangle_quality
from gcnd.data.shapes_organic import FAMILIES as SMOOTH_FAMILIES
from gcnd.data.shapes_organic import lattice_knot
from gcnd.data.shapes_profiles import rectangle
from gcnd.data.shapes_remesh import TriangleStyle, jittered, remeshed
from gcnd.errors import ConfigError

SEEDS = (0, 4)


@pytest.fixture(scope="module", params=[(kind, seed) for kind in SHAPE_KINDS for seed in SEEDS], ids=str)
def shape(request: pytest.FixtureRequest) -> Shape:
    kind, seed = request.param
    return make_shape(seed, kind)


def angles(shape: Shape) -> np.ndarray:
    """The angles between neighbouring faces' normals, in degrees."""
    mesh = trimesh.Trimesh(shape.vertices, shape.faces.astype(np.int64), process=False)
    return np.degrees(mesh.face_adjacency_angles)


def test_shape_is_closed_and_looks_outward(shape: Shape) -> None:
    mesh = trimesh.Trimesh(shape.vertices, shape.faces.astype(np.int64), process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert FACE_RANGE[0] <= len(shape.faces) <= FACE_RANGE[1]
    assert shape.vertices.dtype == np.float64
    assert shape.faces.dtype == np.uint32
    assert len(np.unique(shape.faces)) == len(shape.vertices)


def test_shape_has_unit_diagonal_around_the_origin(shape: Shape) -> None:
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    assert np.linalg.norm(high - low) == pytest.approx(1.0)
    np.testing.assert_allclose(low + high, 0.0, atol=1e-12)


def test_shape_has_few_slivers(shape: Shape) -> None:
    quality = triangle_quality(shape.vertices, shape.faces)
    evenly_meshed = shape.kind in ("cad", "edged") or "remeshed" in shape.name
    assert np.median(quality) > (0.75 if evenly_meshed else 0.2 if "lattice" in shape.name else 0.4)
    assert np.mean(quality < 0.1) <= (0.002 if evenly_meshed else 0.02)


def test_kinds_differ_where_they_should(shape: Shape) -> None:
    found = angles(shape)
    if shape.kind in ("cad", "edged"):
        assert np.mean(found > 30) > 0.003
        assert np.median(found) < 4
    elif shape.kind == "smooth":
        assert np.mean(found > 40) <= 0.004
    else:
        assert np.percentile(found, 90) > 5
        assert np.mean(found > 70) <= (0.02 if "remeshed" in shape.name else 0.08)


def test_same_seed_same_shape() -> None:
    first, second = make_shape(3, "smooth"), make_shape(3, "smooth")
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)
    assert first.name == second.name
    assert make_shape(4, "smooth").name != first.name


@pytest.mark.parametrize("family", sorted(CAD_FAMILIES))
def test_every_cad_family_gives_a_solid(family: str) -> None:
    solid = CAD_FAMILIES[family](np.random.default_rng(5))
    assert solid.volume() > 0
    assert solid.num_tri() > 0


def test_a_cutter_takes_a_chamfer_off_every_edge_of_an_outline() -> None:
    """By hand: 0.1 off the rim of a plate of 2 x 2 and of its hole of 1 x 1, corners mitred either way."""
    outline = rectangle(2.0, 2.0) - rectangle(1.0, 1.0)
    cutter = edge_cutter(outline, np.array([[0.12, 0.02], [-0.02, 0.02], [-0.02, -0.12]]))
    cut = outline.extrude(0.5) - cutter.translate((0.0, 0.0, 0.5))
    # Half the width times the depth along the middle of what is cut, a third of the way in.
    rim, hole = (0.005 * 4 * side for side in (2.0 - 2 * 0.1 / 3, 1.0 + 2 * 0.1 / 3))
    assert outline.extrude(0.5).volume() - cut.volume() == pytest.approx(rim + hole, rel=1e-9)
    assert cut.genus() == 1


@pytest.mark.parametrize("seed", range(6))
def test_an_edged_solid_is_closed_and_fits(seed: int) -> None:
    _, solid = edged_solid(np.random.default_rng(seed))
    assert solid.volume() > 0
    assert len(solid.decompose()) == 1
    low, high = np.array(solid.bounding_box()).reshape(2, 3)
    assert 0.3 < (high - low).max() < 1.3


@pytest.mark.parametrize("family", sorted(SMOOTH_FAMILIES))
def test_every_smooth_family_is_closed(family: str) -> None:
    vertices, faces = SMOOTH_FAMILIES[family](np.random.default_rng(5))
    assert edge_pairs(faces) is not None
    assert trimesh.Trimesh(vertices, faces.astype(np.int64), process=False).volume > 0


@pytest.mark.parametrize("relief", sorted(RELIEFS))
def test_every_relief_is_bounded_and_not_flat(relief: str) -> None:
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (4000, 3))
    height = RELIEFS[relief](np.random.default_rng(1), points, 0.1)
    assert height.shape == (4000,)
    assert np.abs(height).max() < 3.0
    assert height.std() > 0.05


def test_iso_surface_shows_no_grid() -> None:
    vertices, faces = iso_surface(lambda p: np.linalg.norm(p, axis=1) - 0.4, np.full(3, 0.5))
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.4).max() < 2e-5
    outward = np.einsum("ij,ij->i", vertices[faces].mean(axis=1), _crosses(vertices, faces))
    assert (outward > 0).all()


def test_iso_surface_keeps_one_piece_without_voids() -> None:
    def field(points: np.ndarray) -> np.ndarray:
        radius = np.linalg.norm(points, axis=1)
        shell = np.maximum(radius - 0.4, 0.2 - radius)
        crumb = np.linalg.norm(points - [0.42, 0.42, 0.42], axis=1) - 0.05
        return np.minimum(shell, crumb)

    vertices, faces = iso_surface(field, np.full(3, 0.5))
    mesh = trimesh.Trimesh(vertices, faces.astype(np.int64), process=False)
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=0.01)


def test_smooth_noise_has_its_wavelength() -> None:
    line = np.zeros((20_000, 3))
    line[:, 0] = np.linspace(0, 40, len(line))
    counts = []
    for seed in range(6):
        values = SmoothNoise(np.random.default_rng(seed), 0.5)(line)
        counts.append(np.sum((values[1:-1] > values[:-2]) & (values[1:-1] > values[2:])))
    assert 0.3 < 40 / np.mean(counts) < 0.7


def test_sizes_follow_the_style() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.uint32)

    def spread(style: TriangleStyle) -> float:
        v, f = remeshed(
            np.random.default_rng(0), vertices, faces, n_faces=12_000, feature_angle=180.0, style=style
        )
        assert 9_000 < len(f) < 16_000
        lengths = np.linalg.norm(v[f[:, 0]] - v[f[:, 1]], axis=1)
        return float(lengths.std() / lengths.mean())

    even = spread(TriangleStyle())
    assert even < 0.15
    assert spread(TriangleStyle(noise=0.4)) > 2 * even
    assert spread(TriangleStyle(stretch=1.8)) > 1.5 * even


def test_jitter_stays_within_planes_and_off_edges() -> None:
    box = trimesh.creation.box().subdivide().subdivide().subdivide().subdivide()
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces, dtype=np.uint32)
    moved = jittered(np.random.default_rng(0), vertices, faces, 0.1)
    on_edge = (np.abs(np.abs(vertices) - 0.5) < 1e-12).sum(axis=1) >= 2
    np.testing.assert_array_equal(moved[on_edge], vertices[on_edge])
    assert np.mean(np.any(moved != vertices, axis=1)) > 0.5
    np.testing.assert_allclose(np.abs(moved).max(axis=1), 0.5, atol=1e-12)


def test_subdivision_follows_a_sphere() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.uint32)
    finer, finer_faces = subdivided(vertices, faces, vertices)
    chord_depth = 1 - np.linalg.norm(vertices[faces[:, :2]].mean(axis=1), axis=1).min()
    assert len(finer_faces) == 4 * len(faces)
    assert edge_pairs(finer_faces) is not None
    assert np.abs(np.linalg.norm(finer, axis=1) - 1).max() < 0.6 * chord_depth


def test_decimation_spends_triangles_where_the_surface_bends() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    stretched, faces = np.asarray(ball.vertices) * [4.0, 1.0, 1.0], np.asarray(ball.faces, dtype=np.uint32)
    vertices, kept = decimated(stretched, faces, 3000)
    assert len(kept) == pytest.approx(3000, abs=2)
    assert edge_pairs(kept) is not None
    assert len(np.unique(kept)) == len(vertices)
    places = vertices[kept].mean(axis=1)
    areas = 0.5 * np.linalg.norm(_crosses(vertices, kept), axis=1)
    tips = np.abs(places[:, 0]) > 3.5
    assert np.median(areas[tips]) < 0.5 * np.median(areas[~tips])
    assert np.abs(np.linalg.norm(vertices / [4.0, 1.0, 1.0], axis=1) - 1).max() < 0.02


@pytest.mark.parametrize("rounds", [1, 2])
def test_subdivision_from_few_faces_stays_near_the_surface(rounds: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.uint32)
    finer, finer_faces = subdivided_from_coarse(vertices, faces, 8000, rounds)
    assert len(finer_faces) == 8000
    assert edge_pairs(finer_faces) is not None
    assert np.abs(np.linalg.norm(finer, axis=1) - 1).max() < 0.03


def test_lattice_knot_is_closed() -> None:
    vertices, faces = lattice_knot(np.random.default_rng(2), 300, 40)
    assert len(faces) == 24_000
    assert is_sound(vertices, faces)


def test_unsound_meshes_are_seen() -> None:
    shape = make_shape(0, "smooth")
    assert is_sound(shape.vertices, shape.faces)
    assert not is_sound(shape.vertices, shape.faces[:-1])
    assert not is_sound(shape.vertices, shape.faces[:, ::-1])
    turned = shape.faces.copy()
    turned[0] = turned[0, ::-1]
    assert not is_sound(shape.vertices, turned)
    assert not is_sound(np.where(np.arange(3) == 0, np.nan, shape.vertices), shape.faces)
    assert not is_sound(shape.vertices * [1, 1, 1e-4], shape.faces, sharp_angle=20.0, sharp_share=0.0)


def test_cache_reads_what_it_wrote(tmp_path: Path) -> None:
    kinds: dict[ShapeKind, float] = {"smooth": 1.0}
    made = load_shapes(2, 10, tmp_path, workers=2, kinds=kinds)
    files = sorted(tmp_path.iterdir())
    assert [f.name for f in files] == [shape_path(tmp_path, s, "smooth").name for s in (10, 11)]
    stamps = [f.stat().st_mtime_ns for f in files]
    files[1].write_bytes(b"damaged")
    again = load_shapes(2, 10, tmp_path, workers=1, kinds=kinds)
    assert files[0].stat().st_mtime_ns == stamps[0]
    for first, second in zip(made, again, strict=True):
        assert (first.name, first.kind) == (second.name, second.kind)
        np.testing.assert_array_equal(first.vertices, second.vertices)
        np.testing.assert_array_equal(first.faces, second.faces)
    expected = make_shape(11, "smooth")
    np.testing.assert_array_equal(again[1].vertices, expected.vertices)


def test_kinds_come_in_their_shares() -> None:
    sequence = kind_sequence(100, {"cad": 5, "smooth": 2, "feature": 3})
    assert [sequence.count(kind) for kind in SHAPE_KINDS] == [50, 20, 30, 0]
    assert kind_sequence(30, {"cad": 5, "smooth": 2, "feature": 3}) == sequence[:30]


def test_bad_values_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="teapot"):
        make_shape(0, "teapot")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="-1"):
        make_shape(-1)
    with pytest.raises(ConfigError, match="teapot"):
        kind_sequence(3, {"teapot": 1.0})  # type: ignore[dict-item]
    with pytest.raises(ConfigError, match="0"):
        kind_sequence(3, {"cad": 0.0})
    with pytest.raises(ConfigError, match="workers"):
        load_shapes(1, 0, tmp_path, workers=0)


def _crosses(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
