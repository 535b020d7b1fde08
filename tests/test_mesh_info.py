"""Counts on tiny meshes, against tables made by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from gcnd.mesh_info import mesh_info

TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TETRAHEDRON_FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def test_tetrahedron() -> None:
    assert mesh_info(TETRAHEDRON, TETRAHEDRON_FACES) == {
        "vertices": 4,
        "faces": 4,
        "boundary_edges": 0,
        "non_manifold_edges": 0,
        "misoriented_edges": 0,
        "components": 1,
        "isolated_vertices": 0,
        "zero_area_faces": 0,
        "duplicate_faces": 0,
        "duplicate_vertices": 0,
        "bounding_box_diagonal": pytest.approx(3**0.5, abs=1e-15),
        "mean_edge_length": pytest.approx((3 + 3 * 2**0.5) / 6, abs=1e-15),
        "edge_length_variation": pytest.approx(3 - 2 * 2**0.5, abs=1e-15),
        "watertight": True,
    }


@pytest.mark.parametrize(
    ("vertices", "faces", "expected"),
    [
        # Two triangles on an edge.
        (
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
            [[0, 1, 2], [0, 2, 3]],
            {"boundary_edges": 4, "components": 1, "watertight": False},
        ),
        # The same, one of them turned over.
        (
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
            [[0, 1, 2], [0, 3, 2]],
            {"boundary_edges": 4, "misoriented_edges": 1, "components": 1},
        ),
        # Three faces on one edge.
        (
            [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]],
            [[0, 1, 2], [0, 1, 3], [0, 1, 4]],
            {"boundary_edges": 6, "non_manifold_edges": 1, "components": 1},
        ),
        # An hourglass: two faces that share a vertex only hang together.
        (
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, 1, 0]],
            [[0, 1, 2], [0, 3, 4]],
            {"boundary_edges": 6, "components": 1},
        ),
        # Two apart, and a vertex of no face, which is no component.
        (
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [5, 0, 0], [6, 0, 0], [6, 1, 0], [9, 9, 9]],
            [[0, 1, 2], [3, 4, 5]],
            {"boundary_edges": 6, "components": 2, "isolated_vertices": 1},
        ),
        # The same face turned and turned round; then the edges have three faces.
        (
            [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
            [[0, 1, 2], [1, 2, 0], [2, 1, 0]],
            {"duplicate_faces": 2, "non_manifold_edges": 3, "boundary_edges": 0},
        ),
        # Corners on a line have no area but edges; two corners at one place have neither.
        (
            [[0, 0, 0], [0.1, 0.1, 0.1], [0.3, 0.3, 0.3], [1, 0, 0]],
            [[0, 1, 2], [0, 3, 3], [0, 1, 3]],
            {"zero_area_faces": 2, "boundary_edges": 4, "components": 1},
        ),
        # A vertex written twice, once as −0, closes the seam between two faces.
        (
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [-0.0, 0, 0], [0, 1, 0]],
            [[0, 1, 2], [3, 2, 4]],
            {"duplicate_vertices": 1, "boundary_edges": 4, "components": 1},
        ),
    ],
)
def test_hand_counts(vertices: object, faces: object, expected: dict[str, object]) -> None:
    info = mesh_info(vertices, faces)  # type: ignore[arg-type]
    assert {name: info[name] for name in expected} == expected  # type: ignore[literal-required]


def test_rounding_does_not_give_a_line_an_area() -> None:
    direction = np.array([0.1, 0.7, 0.3])
    on_a_line = np.outer([0.0, 1 / 3, 0.77], direction)
    # The premise: rounding leaves a cross product that is small and not zero.
    assert 0.0 < np.linalg.norm(np.cross(on_a_line[1], on_a_line[2])) < 1e-15
    assert mesh_info(on_a_line, [[0, 1, 2]])["zero_area_faces"] == 1
    assert mesh_info([[0, 0, 0], [0, 0, 0], [1, 0, 0]], [[0, 1, 2]])["zero_area_faces"] == 1


def test_soup_of_a_closed_mesh_is_watertight() -> None:
    sphere = trimesh.creation.icosphere(2)
    corners = sphere.vertices[sphere.faces].reshape(-1, 3)
    info = mesh_info(corners, np.arange(len(corners)).reshape(-1, 3))
    assert info["watertight"]
    assert info["components"] == 1
    assert info["duplicate_vertices"] == len(corners) - len(sphere.vertices)
    assert info["mean_edge_length"] == pytest.approx(sphere.edges_unique_length.mean(), rel=1e-12)
    relative = sphere.edges_unique_length / sphere.edges_unique_length.mean()
    assert info["edge_length_variation"] == pytest.approx(relative.std(), rel=1e-9)


@pytest.mark.parametrize("scale", [1e-150, 1e-6, 1e6, 1e150])
def test_zero_area_does_not_depend_on_scale(scale: float) -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]]) * scale
    assert mesh_info(vertices, [[0, 1, 2], [0, 1, 3]])["zero_area_faces"] == 1


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 9), st.integers(1, 12))
def test_edges_against_a_loop(seed: int, n_vertices: int, n_faces: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.integers(0, 3, (n_vertices, 3)).astype(float)
    faces = rng.integers(0, n_vertices, (n_faces, 3))
    faces_at_edge: dict[frozenset[tuple[float, ...]], int] = {}
    for face in faces:
        corners = [tuple(vertices[v].tolist()) for v in face]
        if len(set(corners)) == 3:
            for a, b in ((0, 1), (1, 2), (2, 0)):
                edge = frozenset((corners[a], corners[b]))
                faces_at_edge[edge] = faces_at_edge.get(edge, 0) + 1
    info = mesh_info(vertices, faces)
    counts = list(faces_at_edge.values())
    assert info["boundary_edges"] == counts.count(1)
    assert info["non_manifold_edges"] == sum(count > 2 for count in counts)
    assert info["duplicate_vertices"] == n_vertices - len({tuple(v) for v in vertices.tolist()})
    used = {tuple(vertices[v].tolist()) for v in faces.ravel()}
    group = {position: position for position in used}
    for _ in faces:
        for face in faces:
            lowest = min(group[tuple(vertices[v].tolist())] for v in face)
            for v in face:
                group[tuple(vertices[v].tolist())] = lowest
    assert info["components"] == len(set(group.values()))
