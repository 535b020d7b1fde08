"""Nearest points against all triangles, on meshes of very different ones."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scan_cases import ball

from gcnd.scans.closest import Surface, nearest_on_triangles


def by_all_triangles(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distances by trimesh's own test of every point with every triangle."""
    triangles = np.tile(vertices[faces], (len(points), 1, 1))
    repeated = np.repeat(points, len(faces), axis=0)
    found = trimesh.triangles.closest_point(triangles, repeated)
    return np.linalg.norm(found - repeated, axis=1).reshape(len(points), -1).min(axis=1)


def uneven() -> tuple[np.ndarray, np.ndarray]:
    """A fine ball beside a box of twelve triangles, long and thin."""
    vertices, faces = ball(2)
    box = trimesh.creation.box((30.0, 0.2, 4.0))
    return np.concatenate([vertices, np.array(box.vertices) + np.array([0, 1.5, 0])]), np.concatenate(
        [faces, np.array(box.faces) + len(vertices)]
    )


@pytest.mark.parametrize("spread", [0.01, 1.0, 20.0])
def test_distances_are_those_of_all_triangles(spread: float) -> None:
    vertices, faces = uneven()
    rng = np.random.default_rng(1)
    points = vertices[rng.integers(len(vertices), size=200)] + spread * rng.standard_normal((200, 3))
    found = Surface(vertices, faces).nearest(points)
    distance = np.linalg.norm(found.points - points, axis=1)
    np.testing.assert_allclose(distance, by_all_triangles(points, vertices, faces), rtol=1e-9, atol=1e-12)
    own = nearest_on_triangles(points, vertices[faces[found.face_ids]])
    np.testing.assert_allclose(np.linalg.norm(own - points, axis=1), distance, rtol=1e-9, atol=1e-12)


def test_points_on_the_surface_stay() -> None:
    vertices, faces = uneven()
    weights = np.random.default_rng(2).dirichlet((1, 1, 1), len(faces))
    points = np.einsum("fc,fcx->fx", weights, vertices[faces])
    np.testing.assert_allclose(Surface(vertices, faces).nearest(points).points, points, atol=1e-12)


def test_few_triangles_and_triangles_without_area() -> None:
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [2, 0, 0], [0, 4, 0]])
    line = Surface(vertices, np.array([[0, 1, 2]])).nearest(np.array([[1.0, 3, 0], [9, 0, 0]]))
    np.testing.assert_allclose(line.points, [[1, 0, 0], [4, 0, 0]], atol=1e-12)
    both = Surface(vertices, np.array([[0, 1, 2], [0, 1, 3]])).nearest(np.array([[1.0, 1, 5]]))
    np.testing.assert_allclose(both.points, [[1, 1, 0]], atol=1e-12)
    assert both.face_ids.tolist() == [1]


def test_no_points() -> None:
    assert Surface(*ball(1)).nearest(np.zeros((0, 3))).points.shape == (0, 3)
