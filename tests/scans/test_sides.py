"""Which side is out: closed bodies by their volume, what lies in them with them, open ones not at all."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scan_cases import ball, some_of, square, turned

from gcnd import _geom
from gcnd.scans.sides import Sides, find_sides

BALL, FACES = ball(2)


def joined(*bodies: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in bodies])
    faces = [faces + start for (_, faces), start in zip(bodies, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in bodies]), np.concatenate(faces).astype(np.uint32)


def outward(sides: Sides, vertices: np.ndarray, faces: np.ndarray, center: np.ndarray) -> np.ndarray:
    towards = np.einsum("fx,fx->f", sides.normals, vertices[faces].mean(axis=1) - center)
    return towards > 0


@pytest.mark.parametrize("share", [0.0, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("is_apart", [False, True])
def test_a_closed_body_looks_outward(share: float, is_apart: bool) -> None:
    vertices, faces = BALL + 100, turned(FACES, some_of(FACES, share))
    if is_apart:  # as STL has them
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    sides = find_sides(vertices, faces)
    assert sides.has_outside.all()
    assert outward(sides, vertices, faces, np.full(3, 100.0)).all()


@pytest.mark.parametrize("is_inside_out", [False, True])
def test_what_lies_in_a_body_turns_with_it(is_inside_out: bool) -> None:
    """A shell, in its cavity a ball, and another ball beside them that is inside out."""
    shell = [(BALL, FACES), (0.8 * BALL, turned(FACES)), (0.3 * BALL, FACES)]
    beside = BALL + np.array([2.5, 0, 0])
    vertices, faces = joined(
        *[(v, turned(f) if is_inside_out else f) for v, f in shell], (beside, turned(FACES))
    )
    sides = find_sides(vertices, faces)
    looks_out = outward(sides, vertices, faces, np.repeat([[0.0, 0, 0], [2.5, 0, 0]], [960, 320], axis=0))
    assert [np.unique(part).tolist() for part in np.split(looks_out, 4)] == [[True], [False], [True], [True]]
    assert sides.has_outside.all()


def test_a_body_that_reaches_out_of_another_is_in_none() -> None:
    """It lies in the other's box, and half of it in the other."""
    small = 0.25 * BALL + 0.57
    vertices, faces = joined((BALL, FACES), (small, turned(FACES)))
    sides = find_sides(vertices, faces)
    assert outward(sides, vertices, faces, np.repeat([[0.0] * 3, [0.57] * 3], 320, axis=0)).all()


def test_bodies_that_share_an_edge_are_two() -> None:
    """Two cubes, one of them inside out: four faces at their common edge, so that neither asks the other."""
    box = trimesh.creation.box()
    vertices, faces = np.array(box.vertices), box.faces
    both = joined((vertices, faces), (vertices + np.array([1, 1, 0]), turned(faces)))
    sides = find_sides(*both)
    assert sides.has_outside.all()
    assert outward(sides, *both, np.repeat([[0.0, 0, 0], [1, 1, 0]], 12, axis=0)).all()


def test_open_faces_look_where_they_are_wanted_and_agree() -> None:
    vertices, faces = square()
    sides = find_sides(vertices, turned(faces, np.array([False, True])))
    assert not sides.has_outside.any()
    assert np.array_equal(sides.normals[0], sides.normals[1])
    wanted = np.array([[0.1, 0, 1], [0.1, 0, -1]])
    assert sides.towards(np.array([1, 1]), wanted)[:, 2].tolist() == [1, -1]
    closed = find_sides(BALL, FACES)
    ids = np.arange(len(FACES))
    assert np.array_equal(closed.towards(ids, -closed.normals), closed.normals)


def test_a_hole_or_one_side_only_leaves_no_outside() -> None:
    strip = np.array([[i, (i + 1) % 5, (i + 2) % 5] for i in range(5)])
    vertices, faces = joined(
        (BALL, FACES[1:]), (BALL + 3, FACES), (np.random.default_rng(1).random((5, 3)), strip)
    )
    assert np.split(find_sides(vertices, faces).has_outside, [319, 639])[1].all()
    assert find_sides(vertices, faces).has_outside.sum() == 320


def test_a_sheet_of_two_layers_stays_as_it_is() -> None:
    """It is closed and encloses nothing but rounding, which has a sign."""
    across = np.array([0.36, 0.48, 0.8])
    flat = BALL - (BALL @ across)[:, None] * across
    for faces in (FACES, turned(FACES)):
        sides = find_sides(flat, faces)
        assert sides.has_outside.all()
        assert np.array_equal(sides.normals, _geom.face_geometry(flat, faces)[0])


def test_faces_that_use_a_vertex_twice_join_nothing_and_part_nothing() -> None:
    edges = turned(FACES)[:, [0, 1, 1, 1, 2, 2, 2, 0, 0]].reshape(-1, 3)
    faces = np.concatenate([edges, turned(FACES)]).astype(np.uint32)
    sides = find_sides(BALL, faces)
    n_edges = len(edges)
    assert outward(sides, BALL, faces, np.zeros(3))[n_edges:].all()
    assert sides.has_outside[n_edges:].all()
    assert not sides.normals[:n_edges].any()


def test_a_sheet_on_an_edge_of_a_cube_leaves_it_closed() -> None:
    box = trimesh.creation.box()
    first, second = box.faces[0][:2]
    vertices = np.concatenate([np.array(box.vertices), [[2.0, 2, 2]]])
    faces = np.concatenate([[[first, second, len(box.vertices)]], turned(box.faces)]).astype(np.uint32)
    sides = find_sides(vertices, faces)
    assert sides.has_outside.tolist() == [False] + [True] * 12
    assert outward(sides, vertices, faces, np.zeros(3))[1:].all()
