"""Sheets with known truth, and errors on parts of them, for the tests of what real scans bring along."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.denoise import Boundary, denoise_arrays
from gcnd.weights import load_cascade

if TYPE_CHECKING:
    from gcnd.nn.cascade import Cascade

Points: TypeAlias = NDArray[np.float64]
Faces: TypeAlias = NDArray[np.uint32]

SIDE = 28
NOISE = 0.2


def sheet(along_x: Points, along_y: Points) -> tuple[Points, Faces]:
    """A flat grid whose lines are at the given places, faces up."""
    n = len(along_y)
    x, y = np.meshgrid(along_x, along_y, indexing="ij")
    corners = (np.arange(len(along_x) - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([corners[:, None] + half for half in ([0, n, n + 1], [0, n + 1, 1])])
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3), faces.astype(np.uint32)


def even_sheet(side: int = SIDE) -> tuple[Points, Faces]:
    return sheet(np.arange(side + 1.0), np.arange(side + 1.0))


def with_noise(vertices: Points, seed: int, level: float | Points = NOISE) -> Points:
    """Heights moved by so much."""
    noisy = vertices.copy()
    noisy[:, 2] += level * np.random.default_rng(seed).normal(size=len(vertices))
    return noisy


@cache
def shipped_weights(preset: str) -> Cascade:
    return load_cascade(preset)


def cleaned(
    vertices: Points, faces: Faces, boundary: Boundary = "along", seed: int = 0, *, preset: str = "fast"
) -> Points:
    weights = shipped_weights(preset)
    return denoise_arrays(vertices, np.ascontiguousarray(faces), weights, boundary=boundary, seed=seed)


def angles(result: Points, truth: Points, faces: Faces) -> Points:
    """Degrees by face (F,)."""
    found, wanted = (_geom.face_geometry(v, np.ascontiguousarray(faces))[0] for v in (result, truth))
    return _geom.normal_angles(found, wanted)


def distance_to(points: Points, vertices: Points, faces: Faces) -> Points:
    """How far each face is from the nearest of some points, seen from above (F,)."""
    centroids = vertices[faces].mean(axis=1)[:, None, :2]
    return np.asarray(np.linalg.norm(centroids - points[None, :, :2], axis=2).min(axis=1))


def rim_loops(faces: Faces) -> list[list[int]]:
    """The loops of edges that one face alone has, as vertex ids; each vertex of a rim has one edge to the next."""
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).tolist()
    runs = {(a, b) for a, b in ends}
    after = {a: b for a, b in ends if (b, a) not in runs}
    loops = []
    while after:
        start, loop = next(iter(after)), []
        while start in after:
            loop.append(start)
            start = after.pop(start)
        loops.append(loop)
    return loops
