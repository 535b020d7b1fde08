"""Noise: its direction, its size, how many vertices move, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gcnd.data.noise import (
    NOISE_KINDS,
    VARYING_RANGE,
    FaceArray,
    FloatArray,
    NoiseKind,
    add_noise,
    mean_edge_length,
    smoothed,
    vertex_normals,
)
from gcnd.errors import ConfigError, MeshError

Mesh = tuple[FloatArray, FaceArray]
ALONG_NORMAL: tuple[NoiseKind, ...] = ("gaussian", "impulsive", "varying", "correlated")


@pytest.fixture(scope="module")
def ellipsoid() -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=5)
    return np.asarray(ball.vertices) * [1.0, 0.8, 0.5], np.asarray(ball.faces, dtype=np.uint32)


def test_mean_edge_length_counts_each_edge_once() -> None:
    # Two triangles of a unit square: four sides of 1 and one shared diagonal.
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    assert mean_edge_length(square, faces) == pytest.approx((4 + np.sqrt(2)) / 5)


def test_vertex_normals_are_weighted_by_area() -> None:
    # At vertex 0 a face of area 1/2 looks along z and one of area 2 along x.
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 2, 0], [0, 0, 2]])
    faces = np.array([[0, 1, 2], [0, 3, 4]], np.uint32)
    expected = np.array([4.0, 0.0, 1.0]) / np.sqrt(17)
    np.testing.assert_allclose(vertex_normals(vertices, faces)[0], expected, atol=1e-15)


@pytest.mark.parametrize("kind", ALONG_NORMAL)
def test_moves_along_the_clean_normal(ellipsoid: Mesh, kind: NoiseKind) -> None:
    vertices, faces = ellipsoid
    offset = add_noise(vertices, faces, kind=kind, level=0.3, seed=5) - vertices
    normals = vertex_normals(vertices, faces)
    across = offset - normals * np.einsum("ij,ij->i", offset, normals)[:, None]
    assert np.abs(across).max() < 1e-12


@pytest.mark.parametrize("level", [0.1, 0.3, 0.7])
def test_gaussian_deviation_is_the_level(ellipsoid: Mesh, level: float) -> None:
    vertices, faces = ellipsoid
    offset = add_noise(vertices, faces, level=level, seed=1) - vertices
    size = np.einsum("ij,ij->i", offset, vertex_normals(vertices, faces)) / mean_edge_length(vertices, faces)
    # Four standard errors of the mean and of the deviation.
    assert abs(size.mean()) < 4 * level / np.sqrt(len(vertices))
    assert abs(size.std() - level) < 4 * level / np.sqrt(2 * len(vertices))


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.6, 1.0])
def test_impulsive_moves_the_fraction(ellipsoid: Mesh, fraction: float) -> None:
    vertices, faces = ellipsoid
    offset = add_noise(vertices, faces, kind="impulsive", level=0.3, fraction=fraction, seed=2) - vertices
    size = np.linalg.norm(offset, axis=1)
    moved = size > 0
    assert moved.sum() == round(fraction * len(vertices))
    if fraction > 0:
        deviation = np.sqrt((size[moved] ** 2).mean()) / mean_edge_length(vertices, faces)
        assert abs(deviation - 0.3) < 4 * 0.3 / np.sqrt(2 * moved.sum())


def test_isotropic_is_alike_in_every_coordinate(ellipsoid: Mesh) -> None:
    vertices, faces = ellipsoid
    offset = add_noise(vertices, faces, kind="isotropic", level=0.2, seed=3) - vertices
    sigma = 0.2 * mean_edge_length(vertices, faces)
    bound = 4.5 * sigma**2 * np.sqrt(2 / len(vertices))
    np.testing.assert_allclose(np.cov(offset.T), sigma**2 * np.eye(3), atol=bound)


def test_varying_changes_over_the_mesh_within_its_range(ellipsoid: Mesh) -> None:
    vertices, faces = ellipsoid
    # The same place gets the same factor under the same seed, so a large sample of seeds is not needed: smoothing
    # the squares over the graph estimates the local variance.
    offset = add_noise(vertices, faces, kind="varying", level=0.2, seed=4) - vertices
    squares = (offset**2).sum(axis=1) / (0.2 * mean_edge_length(vertices, faces)) ** 2
    local = np.sqrt(smoothed(squares, faces, 40))
    low, high = VARYING_RANGE
    assert local.min() < 0.7
    assert local.max() > 1.3
    expected = (high**3 - low**3) / (3 * (high - low))
    assert squares.mean() == pytest.approx(expected, rel=0.1)


def test_correlated_has_the_level_and_low_frequency(ellipsoid: Mesh) -> None:
    vertices, faces = ellipsoid
    normals = vertex_normals(vertices, faces)

    def neighbour_correlation(kind: NoiseKind) -> float:
        offset = add_noise(vertices, faces, kind=kind, level=0.2, seed=6) - vertices
        size = np.einsum("ij,ij->i", offset, normals)
        return float(np.corrcoef(size[faces[:, 0]], size[faces[:, 1]])[0, 1])

    offset = add_noise(vertices, faces, kind="correlated", level=0.2, seed=6) - vertices
    root_mean_square = np.sqrt((offset**2).sum(axis=1).mean())
    assert root_mean_square == pytest.approx(0.2 * mean_edge_length(vertices, faces), rel=1e-9)
    assert abs(neighbour_correlation("gaussian")) < 0.05
    assert neighbour_correlation("correlated") > 0.5


@pytest.mark.parametrize("kind", NOISE_KINDS)
def test_same_seed_same_noise(ellipsoid: Mesh, kind: NoiseKind) -> None:
    vertices, faces = ellipsoid
    before = vertices.copy()
    first = add_noise(vertices, faces, kind=kind, seed=9)
    np.testing.assert_array_equal(first, add_noise(vertices, faces, kind=kind, seed=9))
    assert not np.array_equal(first, add_noise(vertices, faces, kind=kind, seed=10))
    np.testing.assert_array_equal(vertices, before)


@pytest.mark.parametrize("kind", NOISE_KINDS)
def test_repeated_vertices_move_together(ellipsoid: Mesh, kind: NoiseKind) -> None:
    vertices, faces = ellipsoid
    soup = vertices[faces].reshape(-1, 3)
    soup_faces = np.arange(len(soup), dtype=np.uint32).reshape(-1, 3)
    noisy = add_noise(soup, soup_faces, kind=kind, seed=7)
    ids = faces.reshape(-1)
    welded = np.zeros_like(vertices)
    welded[ids] = noisy
    np.testing.assert_array_equal(noisy, welded[ids])


def test_size_follows_the_mesh(ellipsoid: Mesh) -> None:
    vertices, faces = ellipsoid
    small = add_noise(vertices, faces, seed=8) - vertices
    large = add_noise(8 * vertices, faces, seed=8) - 8 * vertices
    np.testing.assert_allclose(large, 8 * small, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", NOISE_KINDS)
@pytest.mark.parametrize("doublings", [-1000, -600, -200, 200, 490])
def test_no_size_is_too_small_or_too_large(kind: NoiseKind, doublings: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    # A vertex that no face uses, last in any order.
    vertices, faces = np.append(ball.vertices, [[1e149, 0, 0]], axis=0), ball.faces.astype(np.uint32)
    usual = add_noise(vertices, faces, kind=kind, seed=8)
    assert np.ptp(usual[:-1] - ball.vertices) > 0.1
    sized = vertices.copy()
    sized[:-1] = np.ldexp(ball.vertices, doublings)
    noisy = np.ldexp(add_noise(sized, faces, kind=kind, seed=8)[:-1], -doublings)
    np.testing.assert_allclose(noisy, usual[:-1], rtol=1e-13, atol=1e-15)


def test_level_zero_moves_nothing(ellipsoid: Mesh) -> None:
    vertices, faces = ellipsoid
    for kind in NOISE_KINDS:
        np.testing.assert_array_equal(add_noise(vertices, faces, kind=kind, level=0.0), vertices)


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"kind": "pink"}, "pink"),
        ({"level": -0.1}, "-0.1"),
        ({"level": float("nan")}, "nan"),
        ({"fraction": 1.5}, "1.5"),
        ({"fraction": -0.1}, "-0.1"),
    ],
)
def test_bad_values_are_named(ellipsoid: Mesh, wrong: dict[str, object], word: str) -> None:
    vertices, faces = ellipsoid
    with pytest.raises(ConfigError, match=word) as caught:
        add_noise(vertices, faces, **wrong)  # type: ignore[arg-type]
    assert caught.value.hint


@pytest.mark.parametrize("bad", [-1, 162, 2**40])
def test_faces_without_vertices_are_named(ellipsoid: Mesh, bad: int) -> None:
    vertices, faces = ellipsoid
    faces = np.asarray(faces, dtype=np.int64).copy()
    faces[7, 1] = bad if bad < 0 else bad + len(vertices)
    with pytest.raises(MeshError, match="face 7 is"):
        add_noise(vertices, faces)


@pytest.mark.parametrize("level", [-0.1, 1e308, float("nan"), float("inf")])
def test_levels_out_of_range_are_named(ellipsoid: Mesh, level: float) -> None:
    with pytest.raises(ConfigError, match="noise level is"):
        add_noise(*ellipsoid, level=level)
