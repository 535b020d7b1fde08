"""Every error of a result against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gcnd.compare.measures import enclosed_volume, measure

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32)
MEAN_EDGE = (3 + 3 * np.sqrt(2)) / 6


def test_the_truth_has_no_error() -> None:
    found = measure(CORNERS, CORNERS, TETRAHEDRON, samples=500)
    assert (found.e_a, found.displacement_mean, found.displacement_max) == (0, 0, 0)
    assert (found.flipped, found.volume_change) == (0, 0)
    assert 0 < found.e_v < 100  # points on both surfaces are drawn apart


def test_a_shift_is_displacement_and_nothing_else() -> None:
    found = measure(CORNERS + np.array([0.0, 0.0, 0.5]), CORNERS, TETRAHEDRON, samples=500)
    assert found.e_a == pytest.approx(0, abs=1e-6)
    assert found.displacement_mean == pytest.approx(0.5 / MEAN_EDGE)
    assert found.displacement_max == pytest.approx(0.5 / MEAN_EDGE)
    assert found.volume_change == pytest.approx(0, abs=1e-9)


def test_one_vertex_moved() -> None:
    """The corner on z goes to height 2: volume doubles, and only it is displaced."""
    result = CORNERS.copy()
    result[3, 2] = 2.0
    found = measure(result, CORNERS, TETRAHEDRON, samples=500)
    assert found.displacement_max == pytest.approx(1 / MEAN_EDGE)
    assert found.displacement_mean == pytest.approx(0.25 / MEAN_EDGE)
    assert found.volume_change == pytest.approx(100)
    slanted = np.degrees(np.arccos(5 / (3 * np.sqrt(3))))  # (2, 2, 1)/3 against (1, 1, 1)/√3
    assert found.e_a == pytest.approx(slanted / 4)
    assert found.flipped == 0


def test_a_mirrored_mesh_is_flipped_and_its_volume_negative() -> None:
    found = measure(CORNERS * [1, 1, -1], CORNERS, TETRAHEDRON, samples=500)
    assert found.volume_change == pytest.approx(-200)
    # Both walls turn round, the slant to (-1, -1, 1)/√3, and the floor stays.
    assert found.flipped == 3
    assert found.e_a == pytest.approx((180 + 180 + np.degrees(np.arccos(-1 / 3))) / 4)
    assert found.displacement_max == pytest.approx(2 / MEAN_EDGE)


def test_vertices_without_a_face_do_not_count() -> None:
    truth = np.vstack([CORNERS, [9.0, 9, 9]])
    result = np.vstack([CORNERS, [-9.0, 9, 9]])
    assert measure(result, truth, TETRAHEDRON, samples=500).displacement_max == 0


def test_a_face_without_area_in_the_truth_does_not_count() -> None:
    truth = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3]], dtype=np.uint32)
    result = truth.copy()
    result[3, 2] = 0.5
    found = measure(result, truth, faces, samples=500)
    assert (found.e_a, found.flipped) == (0, 0)


def test_volume_is_for_closed_meshes_and_the_same_anywhere() -> None:
    box = trimesh.creation.box((2, 3, 4))
    vertices, faces = np.array(box.vertices), np.array(box.faces, dtype=np.uint32)
    assert enclosed_volume(vertices, faces) == pytest.approx(24)
    assert enclosed_volume(vertices + 1e6, faces) == pytest.approx(24, rel=1e-6)
    assert enclosed_volume(vertices, faces[:, ::-1]) == pytest.approx(-24)
    assert enclosed_volume(vertices, faces[1:]) is None
    flipped = faces.copy()
    flipped[0] = flipped[0, ::-1]
    assert enclosed_volume(vertices, flipped) is None
    assert measure(vertices, vertices, faces[1:], samples=500).volume_change is None
