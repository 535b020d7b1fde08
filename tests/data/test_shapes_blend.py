"""Edges blended by mean curvature flow: planes stay, edges become fillets of the width asked for."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gcnd import _geom
from gcnd.data.noise import mean_edge_length
from gcnd.data.shapes_blend import _cotangent_laplacian, blended

BOX = trimesh.creation.box().subdivide().subdivide().subdivide().subdivide()
VERTICES, FACES = np.array(BOX.vertices), BOX.faces.astype(np.uint32)


def dense_laplacian(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Cotangents from angles, an edge at a time."""
    n = len(vertices)
    found = np.zeros((n, n))
    for face in faces:
        for k in range(3):
            apex, a, b = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            one, other = vertices[a] - vertices[apex], vertices[b] - vertices[apex]
            angle = np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))
            weight = max(0.0, 1 / np.tan(angle)) / 2
            found[[a, b], [b, a]] -= weight
            found[[a, b], [a, b]] += weight
    return found


def test_the_laplacian_is_that_of_an_explicit_loop() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=1)
    vertices = sphere.vertices * [1, 2, 3]
    laplacian, area = _cotangent_laplacian(vertices, sphere.faces.astype(np.uint32))
    assert np.abs(laplacian.toarray() - dense_laplacian(vertices, sphere.faces)).max() < 1e-9
    assert area.sum() == pytest.approx(trimesh.Trimesh(vertices, sphere.faces).area)


@pytest.mark.parametrize("width", [0.5, 1.0, 2.0])
def test_only_what_is_near_an_edge_of_a_box_moves(width: float) -> None:
    moved = np.linalg.norm(blended(VERTICES, FACES, width) - VERTICES, axis=1)
    edge = mean_edge_length(VERTICES, FACES)
    # How near a vertex is to the nearest of the twelve edges: the second largest coordinate reaches 0.5 there.
    from_edge = 0.5 - np.sort(np.abs(VERTICES), axis=1)[:, 1]
    assert moved[from_edge < 1e-9].min() > 0.05 * width * edge
    assert moved[from_edge < 1e-9].max() < 2 * width * edge
    assert moved[from_edge > 5 * width * edge].max(initial=0) < 0.01 * edge


def test_a_wider_blend_has_a_milder_edge() -> None:
    along_edges = np.sort(np.abs(VERTICES), axis=1)[:, 0] < 0.3  # and not at a corner

    def sharpest(width: float) -> float:
        mesh = trimesh.Trimesh(blended(VERTICES, FACES, width), FACES, process=False)
        chosen = along_edges[mesh.face_adjacency_edges].all(axis=1)
        return float(np.rad2deg(mesh.face_adjacency_angles[chosen].max()))

    angles = [sharpest(width) for width in (0.2, 0.5, 1.0, 2.0)]
    assert angles[0] < 90
    assert angles == sorted(angles, reverse=True)
    assert angles[-1] < 40


def test_an_open_flat_sheet_keeps_its_plane() -> None:
    x, y = np.meshgrid(np.arange(8.0), np.arange(8.0), indexing="ij")
    ids = np.arange(64).reshape(8, 8)
    a, b, c, d = (part.ravel() for part in (ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.uint32)
    sheet = np.stack([x.ravel(), y.ravel(), 0.5 * x.ravel()], 1)
    found = blended(sheet, faces, 1.0)
    assert np.abs(found[:, 2] - 0.5 * found[:, 0]).max() < 1e-12


@given(st.floats(1e-6, 1e6), st.tuples(*[st.floats(-10, 10)] * 3))
def test_it_moves_and_scales_with_the_mesh(scale: float, offset: tuple[float, float, float]) -> None:
    box = trimesh.creation.box().subdivide()
    vertices, faces = np.array(box.vertices), box.faces.astype(np.uint32)
    straight = blended(vertices, faces, 1.0)
    other = blended(vertices * scale + np.array(offset) * scale, faces, 1.0)
    assert np.abs(other / scale - np.array(offset) - straight).max() < 1e-8


def test_faces_without_area_do_no_harm() -> None:
    vertices = np.concatenate([VERTICES, VERTICES[:1]])
    faces = np.concatenate([FACES, [[FACES[0, 0], FACES[0, 1], FACES[0, 1]], [len(VERTICES), 0, 0]]]).astype(
        np.uint32
    )
    found = blended(vertices, faces, 1.0)
    assert np.isfinite(found).all()
    assert np.abs(found[: len(VERTICES)] - blended(VERTICES, FACES, 1.0)).max() < 0.05
    assert np.isfinite(_geom.face_geometry(found, FACES)[0]).all()
