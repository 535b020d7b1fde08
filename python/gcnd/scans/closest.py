"""The nearest point of a triangle mesh, exactly, without a library of ray trees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from gcnd.data.noise import AnyFaces, FloatArray

_FEWEST, _MOST = 24, 4096
"""Pieces that are looked at for a point at first, and at most before all are."""

_SPLIT_ROUNDS = 12
"""A piece is halved no more often."""


class Nearest(NamedTuple):
    """Points of a mesh nearest to given ones.

    Attributes:
        points: (N, 3) float64.
        face_ids: (N,) int64, the face that holds each; of several at one distance any.
    """

    points: FloatArray
    face_ids: npt.NDArray[np.int64]


class Surface:
    """A mesh that is asked for nearest points, often.

    Long triangles are halved for the search, so that a tree of the pieces' centres bounds distances well: a piece whose
    centre is at distance D has no point nearer than D − ρ, ρ its radius around its centre. Pieces are looked at in
    order of their centres until no later one can win, so the answer is exact.

    Args:
        vertices: (V, 3) float64.
        faces: (F, 3), vertex ids; at least one face.

    Example:
        >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        >>> surface = Surface(square, np.array([[0, 1, 2], [0, 2, 3]]))
        >>> surface.nearest(np.array([[0.25, 0.5, 2.0], [3.0, 0.5, 0.0]])).points.tolist()
        [[0.25, 0.5, 0.0], [1.0, 0.5, 0.0]]
    """

    def __init__(self, vertices: FloatArray, faces: AnyFaces) -> None:
        corners = np.asarray(vertices, dtype=np.float64)[np.asarray(faces)]
        self._pieces, self._face_ids = _split(corners)
        centers = self._pieces.mean(axis=1)
        self._radii = np.linalg.norm(self._pieces - centers[:, None], axis=2).max(axis=1)
        self._tree = cKDTree(centers)

    def nearest(self, points: FloatArray) -> Nearest:
        """Returns the nearest point of the surface, and its face, for each of the points (N, 3)."""
        found = np.empty((len(points), 3))
        face_ids = np.empty(len(points), dtype=np.int64)
        open_ids, count = np.arange(len(points)), min(_FEWEST, len(self._pieces))
        while len(open_ids):
            own = points[open_ids]
            found_at = self._tree.query(own, k=[*range(1, count + 1)])
            reach, pieces = np.asarray(found_at[0]), np.asarray(found_at[1], dtype=np.int64)
            found[open_ids], winners = self._best_of(own, reach, pieces)
            face_ids[open_ids] = self._face_ids[winners]
            distance = np.linalg.norm(found[open_ids] - own, axis=1)
            # Rounding must not make a tie look undecided.
            unsure = distance * (1 - 1e-12) > reach[:, -1] - self._radii.max()
            open_ids = open_ids[unsure] if count < len(self._pieces) else open_ids[:0]
            count = min(count * 4 if count < _MOST else len(self._pieces), len(self._pieces))
        return Nearest(found, face_ids)

    def _best_of(
        self, points: FloatArray, reach: FloatArray, pieces: npt.NDArray[np.int64]
    ) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """The nearest points (N, 3) on pieces (N, K) whose centres are at the distances ``reach``, and their pieces."""
        first = nearest_on_triangles(points, self._pieces[pieces[:, 0]])
        bound = np.linalg.norm(first - points, axis=1) * (1 + 1e-12)
        may_win = reach - self._radii[pieces] <= bound[:, None]
        may_win[:, 0] = True
        rows, columns = np.nonzero(may_win)
        rivals = pieces[rows, columns]
        candidates = nearest_on_triangles(points[rows], self._pieces[rivals])
        distance = np.linalg.norm(candidates - points[rows], axis=1)
        counts = may_win.sum(axis=1)
        least = np.minimum.reduceat(distance, np.cumsum(counts) - counts)
        best = np.flatnonzero(distance <= np.repeat(least, counts))
        best = best[np.unique(rows[best], return_index=True)[1]]
        return candidates[best], rivals[best]


def _split(corners: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Halves triangles (F, 3, 3) at their longest side until it is at most twice the median one of the mesh.

    A mesh of few triangles of one size is cut to a hundredth of its extent instead.
    """
    face_ids = np.arange(len(corners))
    longest = _sides(corners).max(axis=1)
    extent = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    limit = max(min(2 * float(np.median(longest)), extent / 10), extent / 400)
    for _ in range(_SPLIT_ROUNDS):
        sides = _sides(corners)
        longs = np.flatnonzero(sides.max(axis=1) > limit)
        if len(longs) == 0:
            break
        first = sides[longs].argmax(axis=1)
        turned = np.stack([corners[longs, (first + i) % 3] for i in range(3)], axis=1)
        middle = (turned[:, 0] + turned[:, 1]) / 2
        corners = np.concatenate(
            [
                np.delete(corners, longs, axis=0),
                np.stack([turned[:, 0], middle, turned[:, 2]], axis=1),
                np.stack([middle, turned[:, 1], turned[:, 2]], axis=1),
            ]
        )
        face_ids = np.concatenate([np.delete(face_ids, longs), face_ids[longs], face_ids[longs]])
    return corners, face_ids


def _sides(corners: FloatArray) -> FloatArray:
    """(F, 3): lengths from corner i to corner i + 1."""
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def nearest_on_triangles(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Returns the nearest point (N, 3) to each point (N, 3) on the triangle (N, 3, 3) of the same place.

    Inside, the foot of the perpendicular; outside, the nearest of the feet on the three sides.

    Example:
        >>> triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
        >>> nearest_on_triangles(np.array([[1.0, 1, 5]]), triangle).tolist()
        [[0.5, 0.5, 0.0]]
    """
    a, ab, ac = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, ac = ab - a, ac - a
    normal = np.cross(ab, ac)
    squared = _dot(normal, normal)
    safe = np.where(squared > 0, squared, 1.0)
    to_p = points - a
    beta = _dot(np.cross(to_p, ac), normal) / safe
    gamma = _dot(np.cross(ab, to_p), normal) / safe
    inside = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (squared > 0)
    best = a + beta[..., None] * ab + gamma[..., None] * ac
    gap = np.where(inside, -1.0, np.inf)
    for i in range(3):
        start = corners[..., i, :]
        side = corners[..., (i + 1) % 3, :] - start
        length = _dot(side, side)
        along = np.clip(_dot(points - start, side) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        foot = start + along[..., None] * side
        away = _dot(points - foot, points - foot)
        nearer = away < gap
        best = np.where(nearer[..., None], foot, best)
        gap = np.where(nearer, away, gap)
    return np.asarray(best)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...x,...x->...", a, b))
