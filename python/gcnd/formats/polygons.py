"""Faces of four corners and more, split into triangles for the work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Polygons", "split_polygons"]

Points = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Polygons:
    """Says which triangles stand for which faces.

    Attributes:
        corners: Of each triangle's corners (T, 3), the place among the corners of all faces, one face after the other.
        owner: The face of each triangle (T,), ascending.
        n_faces: How many faces there are.
    """

    corners: Indices
    owner: Indices
    n_faces: int


def split_polygons(vertices: Points, ids: Indices, lengths: Indices) -> Polygons:
    """Splits faces into triangles that turn the same way; a face of n corners gives n − 2.

    A face of four corners is split along its shorter diagonal, unless only the other leaves both halves facing the same
    way. Larger ones lose ear after ear: the corner whose triangle holds no other corner, seen along the face's mean
    normal, and of several the first.

    Args:
        vertices: Positions (V, 3).
        ids: Vertex of every corner (C,), in [0, V), one face after the other.
        lengths: Corners of each face (F,), three or more each, C in sum.

    Returns:
        The triangles, in the order of the faces.

    Choice: docs/choices.md#polygons.

    Example:
        >>> square = np.array([[0.0, 0, 0], [3, 0, 0], [2, 1, 0], [0, 1, 0]])
        >>> split_polygons(square, np.arange(4), np.array([4])).corners.tolist()
        [[0, 1, 2], [0, 2, 3]]
    """
    counts = lengths - 2
    first = np.cumsum(lengths) - lengths
    place = np.cumsum(counts) - counts
    corners = np.empty((int(counts.sum()), 3), dtype=np.int64)
    is_triangle, is_quad = lengths == 3, lengths == 4
    corners[place[is_triangle]] = first[is_triangle, None] + np.arange(3)
    if is_quad.any():
        halves = first[is_quad, None, None] + _quad_halves(vertices[ids[first[is_quad, None] + np.arange(4)]])
        corners[place[is_quad]], corners[place[is_quad] + 1] = halves[:, 0], halves[:, 1]
    for face_id in np.flatnonzero(lengths > 4):
        start, end = first[face_id], first[face_id] + lengths[face_id]
        corners[place[face_id] : place[face_id] + counts[face_id]] = start + _ears(vertices[ids[start:end]])
    return Polygons(corners, np.repeat(np.arange(len(lengths)), counts), len(lengths))


def _quad_halves(points: NDArray[np.float64]) -> Indices:
    """Corners (Q, 2, 3) of the halves of quads (Q, 4, 3)."""
    by_02, by_13 = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]])

    def is_even(halves: Indices) -> NDArray[np.bool_]:
        a, b, c = (points[:, halves[:, corner]] for corner in range(3))
        normals = np.cross(b - a, c - a)
        agrees: NDArray[np.bool_] = (normals[:, 0] * normals[:, 1]).sum(axis=1) > 0.0
        return agrees

    even_02, even_13 = is_even(by_02), is_even(by_13)
    is_13_shorter = np.linalg.norm(points[:, 3] - points[:, 1], axis=1) < np.linalg.norm(
        points[:, 2] - points[:, 0], axis=1
    )
    takes_13 = np.where(even_02 == even_13, is_13_shorter, even_13)
    halves: Indices = np.where(takes_13[:, None, None], by_13, by_02)
    return halves


def _ears(points: Points) -> list[list[int]]:
    """Corners of the triangles of one polygon (n, 3)."""
    flat = _flattened(points)
    left = list(range(len(points)))
    triangles = []
    while len(left) > 3:
        n_left = len(left)
        around = [(left[k - 1], left[k], left[(k + 1) % n_left]) for k in range(n_left)]
        # A polygon that crosses itself may have no ear: any corner will do then, as it is no surface anyway.
        ear = next((k for k in range(n_left) if _is_ear(flat, around[k], left)), 1)
        triangles.append(list(around[ear]))
        del left[ear]
    return [*triangles, left]


def _flattened(points: Points) -> Points:
    """The polygon seen along its mean normal, anticlockwise (n, 2)."""
    around = points - points.mean(axis=0)
    normal = np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    kept = [(axis + 1) % 3, (axis + 2) % 3]
    flat: Points = around[:, kept if normal[axis] >= 0.0 else kept[::-1]]
    return flat


def _is_ear(flat: Points, corner: tuple[int, int, int], left: list[int]) -> bool:
    a, b, c = flat[list(corner)]

    def side(start: Points, end: Points, points: Points) -> NDArray[np.float64]:
        way, to = end - start, points - start
        found: NDArray[np.float64] = way[0] * to[..., 1] - way[1] * to[..., 0]
        return found

    if not side(a, b, c) > 0.0:
        return False
    others = flat[[k for k in left if k not in corner]]
    is_inside = (side(a, b, others) >= 0.0) & (side(b, c, others) >= 0.0) & (side(c, a, others) >= 0.0)
    return not is_inside.any()
