"""Triangles between pixels, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gcnd.scans.grid import Diagonal, triangulate

NAN = np.nan


def faces_of(
    noisy: list[list[float]], diagonal: Diagonal, exact: list[list[float]] | None = None, limit: float = 0.5
) -> set[tuple[int, ...]]:
    """Triangles as pixel numbers, each started at its smallest."""
    image = np.array(noisy)
    truth = image if exact is None else np.array(exact)
    pixels, faces = triangulate(image, truth, np.full(image.shape, limit), diagonal)
    assert np.array_equal(np.unique(faces), np.arange(len(pixels)))
    found = [tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in pixels[faces]]
    assert len(set(found)) == len(found)
    return set(found)


def test_a_square_is_split_as_told() -> None:
    flat = [[1.0, 1.0], [1.0, 1.0]]
    assert faces_of(flat, "down") == {(0, 2, 3), (0, 3, 1)}
    assert faces_of(flat, "up") == {(0, 2, 1), (1, 2, 3)}
    assert faces_of([[1.0, 1.2], [1.1, 1.0]], "shorter") == {(0, 2, 3), (0, 3, 1)}
    assert faces_of([[1.2, 1.0], [1.0, 1.1]], "shorter") == {(0, 2, 1), (1, 2, 3)}


@pytest.mark.parametrize("diagonal", ["down", "up", "shorter"])
def test_three_pixels_make_one_triangle(diagonal: Diagonal) -> None:
    assert faces_of([[NAN, 1.0], [1.0, 1.0]], diagonal) == {(1, 2, 3)}
    assert faces_of([[1.0, NAN], [1.0, 1.0]], diagonal) == {(0, 2, 3)}
    assert faces_of([[1.0, 1.0], [NAN, 1.0]], diagonal) == {(0, 3, 1)}
    assert faces_of([[1.0, 1.0], [1.0, NAN]], diagonal) == {(0, 2, 1)}
    assert faces_of([[1.0, NAN], [NAN, 1.0]], diagonal) == set()


def test_triangles_look_at_the_camera() -> None:
    rng = np.random.default_rng(0)
    depth = 1 + 0.1 * rng.random((6, 7))
    pixels, faces = triangulate(depth, depth, np.full(depth.shape, 1.0))
    assert len(faces) == 2 * 5 * 6
    rows, columns = np.divmod(pixels, 7)
    # x right, y down, z forward: towards the camera is −z.
    corners = np.stack([columns, rows, np.zeros(len(pixels))], axis=1)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.array_equal(normals[:, 2], -np.ones(len(faces)))


def test_jumps_are_cut_in_either_image() -> None:
    step = [[1.0, 1.0, 2.0], [1.0, 1.0, 2.0]]
    flat = [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
    left = {(0, 3, 4), (0, 4, 1)}
    assert faces_of(step, "down") == left
    assert faces_of(flat, "down", exact=step) == left
    assert faces_of(step, "down", exact=flat) == left
    assert len(faces_of(step, "down", limit=1.0)) == 4
    assert faces_of(step, "down", limit=0.99) == left


def test_nothing_measured_is_no_face() -> None:
    pixels, faces = triangulate(np.full((3, 3), NAN), np.ones((3, 3)), np.ones((3, 3)))
    assert (pixels.shape, faces.shape) == ((0,), (0, 3))
