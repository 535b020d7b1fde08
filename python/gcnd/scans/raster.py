"""What a pinhole camera sees of a mesh: the exact point at the centre of every pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from gcnd.data.noise import AnyFaces, FloatArray
from gcnd.errors import MeshError
from gcnd.scans.camera import Camera

_CANDIDATES_AT_ONCE = 2_000_000
"""Pairs of a triangle and a pixel of its bounding box that are looked at together."""

_EDGE_SLACK = 1e-9
"""A pixel this far outside a triangle, in barycentric coordinates, still counts: no cracks along shared edges."""


class View(NamedTuple):
    """What each pixel sees.

    Attributes:
        points: (H, W, 3) float64 in the camera's frame, NaN where nothing is hit.
        angles: (H, W) float64, between the ray and the normal of the face it hits, 0 to π/2 radians; NaN where
            nothing is hit.
    """

    points: FloatArray
    angles: FloatArray

    @property
    def depth(self) -> FloatArray:
        """(H, W), the z coordinate of the points."""
        return self.points[..., 2]


class _Triangles(NamedTuple):
    """Triangles on the image: λ_i(u, v) = gradient_i · (u, v) + offset_i, 1/z = Σ λ_i / z_i."""

    gradient: FloatArray
    offset: FloatArray
    inverse_z: FloatArray
    low: npt.NDArray[np.int64]
    size: npt.NDArray[np.int64]


def render(vertices: FloatArray, faces: AnyFaces, camera: Camera) -> View:
    """Finds the nearest point of a mesh on the ray through each pixel's centre.

    Triangles are projected and kept in a depth buffer, which at the centres of pixels is as exact as casting rays: with
    λ the barycentric coordinates on the image, 1/z = Σ λ_i / z_i, and the point is Σ μ_i p_i, μ_i = z λ_i / z_i. Faces
    are seen from both sides; of two at the same depth the later one is taken.

    Args:
        vertices: (V, 3) float64 in the camera's frame.
        faces: (F, 3), vertex ids.
        camera: Intrinsics.

    Returns:
        The exact points and angles of incidence.

    Raises:
        MeshError: A vertex is not in front of the camera.

    Example:
        >>> corners = np.array([[-1.0, -1, 2], [1, -1, 2], [-1, 1, 2]])
        >>> seen = render(corners, np.array([[0, 1, 2]]), Camera.centered(5, 5, 2.0))
        >>> float(seen.depth[1, 1]), bool(np.isnan(seen.depth[4, 4]))
        (2.0, True)
    """
    behind = vertices[:, 2] <= 0
    if behind.any():
        vertex_id = int(np.argmax(behind))
        raise MeshError(f"vertex {vertex_id} at depth {vertices[vertex_id, 2]} is not in front of the camera")
    ids, triangles = _projected(vertices, faces, camera)
    count = camera.width * camera.height
    nearest = np.zeros(count)
    winner = np.full(count, -1, dtype=np.int64)
    weights = np.zeros((count, 3))
    total = np.cumsum(triangles.size.prod(axis=1))
    start = 0
    while start < len(ids):
        done = total[start - 1] if start else 0
        stop = max(int(np.searchsorted(total, done + _CANDIDATES_AT_ONCE)), start + 1)
        _draw(triangles, np.arange(start, stop), camera.width, nearest, winner, weights)
        start = stop
    hit = winner >= 0
    points = np.full((count, 3), np.nan)
    angles = np.full(count, np.nan)
    share = np.maximum(weights[hit], 0.0) * triangles.inverse_z[winner[hit]]
    share /= share.sum(axis=1, keepdims=True)
    corners = vertices[np.asarray(faces)[ids[winner[hit]]]]
    points[hit] = np.einsum("pc,pcx->px", share, corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(points[hit], axis=1)
    cosine = np.abs(np.einsum("px,px->p", normals, points[hit]))
    angles[hit] = np.arccos(np.clip(cosine / np.maximum(lengths, np.finfo(float).tiny), 0.0, 1.0))
    shape = (camera.height, camera.width)
    return View(points.reshape(*shape, 3), angles.reshape(shape))


def _projected(
    vertices: FloatArray, faces: AnyFaces, camera: Camera
) -> tuple[npt.NDArray[np.int64], _Triangles]:
    """Projects the faces and returns those that may cover a pixel's centre, with their ids."""
    u, v = camera.project(vertices)
    corners = np.stack([u, v], axis=1)[np.asarray(faces)]
    limit = np.array([camera.width - 1, camera.height - 1])
    low = np.maximum(np.ceil(corners.min(axis=1) - 1e-6), 0).astype(np.int64)
    high = np.minimum(np.floor(corners.max(axis=1) + 1e-6), limit).astype(np.int64)
    after, before = np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)
    edge = before - after
    gradient = np.stack([-edge[..., 1], edge[..., 0]], axis=2)
    area = np.einsum("fx,fx->f", gradient[:, 0], corners[:, 0] - after[:, 0])
    ids = np.flatnonzero(np.all(high >= low, axis=1) & (area != 0))
    gradient = gradient[ids] / area[ids, None, None]
    offset = -np.einsum("fcx,fcx->fc", gradient, after[ids])
    inverse_z = 1.0 / vertices[np.asarray(faces)[ids], 2]
    return ids, _Triangles(gradient, offset, inverse_z, low[ids], high[ids] - low[ids] + 1)


def _draw(
    triangles: _Triangles,
    chosen: npt.NDArray[np.int64],
    width: int,
    nearest: FloatArray,
    winner: npt.NDArray[np.int64],
    weights: FloatArray,
) -> None:
    """Draws triangles into a buffer of 1/z, the triangle that is nearest, and its barycentric coordinates."""
    counts = triangles.size[chosen].prod(axis=1)
    which = np.repeat(chosen, counts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    columns = triangles.size[which, 0]
    u = triangles.low[which, 0] + number % columns
    v = triangles.low[which, 1] + number // columns
    # Column by column: numpy is slow along an axis of three.
    parts = [
        triangles.gradient[which, i, 0] * u + triangles.gradient[which, i, 1] * v + triangles.offset[which, i]
        for i in range(3)
    ]
    inside = np.flatnonzero(np.minimum(np.minimum(parts[0], parts[1]), parts[2]) >= -_EDGE_SLACK)
    share = np.stack([part[inside] for part in parts], axis=1)
    which, pixel = which[inside], (v * width + u)[inside]
    inverse_z = np.einsum("pc,pc->p", share, triangles.inverse_z[which])
    ahead = np.flatnonzero(inverse_z >= nearest[pixel])
    # Of values assigned to one place numpy keeps the last: the nearest.
    order = ahead[np.argsort(inverse_z[ahead], kind="stable")]
    nearest[pixel[order]] = inverse_z[order]
    winner[pixel[order]] = which[order]
    weights[pixel[order]] = share[order]
