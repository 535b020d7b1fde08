"""Triangles as programs leave them: thinned out by quadrics, or thinned and subdivided again."""

from __future__ import annotations

import fast_simplification
import numpy as np

from gcnd.data.noise import FaceArray, FloatArray, smoothed, vertex_normals
from gcnd.data.shapes_mesh import subdivided


def decimated(
    vertices: FloatArray, faces: FaceArray, n_faces: float, *, greed: float = 7.0
) -> tuple[FloatArray, FaceArray]:
    """Return a mesh of about `n_faces` triangles, made by collapsing edges in the order of their quadric error.

    Most published scans of statues were thinned in this way: triangles grow large and long where the surface is
    flat, and detail ends at the size of single triangles.

    Args:
        vertices: (V, 3) float64.
        faces: (F, 3) uint32, with F > `n_faces`.
        n_faces: How many to keep.
        greed: How fast the error bound rises, 3 to 10; higher is faster and strays further from the order.

    Returns:
        (V', 3) float64 vertices and (F', 3) uint32 faces; not always manifold.

    Source: M. Garland and P. Heckbert, Surface Simplification Using Quadric Error Metrics, 1997.

    Example:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(subdivisions=4)
        >>> len(decimated(ball.vertices, ball.faces, 1000)[1])
        1000
    """
    points, triangles = fast_simplification.simplify(
        np.ascontiguousarray(vertices, dtype=np.float64),
        np.ascontiguousarray(faces, dtype=np.int64),
        target_count=round(n_faces),
        agg=greed,
    )
    used, compact = np.unique(triangles, return_inverse=True)
    return np.asarray(points[used], np.float64), compact.reshape(-1, 3).astype(np.uint32)


def subdivided_from_coarse(
    vertices: FloatArray, faces: FaceArray, n_faces: float, rounds: int
) -> tuple[FloatArray, FaceArray]:
    """Return a mesh of about `n_faces` triangles, thinned out and then subdivided `rounds` times, 4 for 1.

    As models are that a person drew with few polygons: sizes vary from part to part, and within a part every triangle
    has the shape of its neighbours.

    Args:
        vertices: (V, 3) float64.
        faces: (F, 3) uint32.
        n_faces: How many in the end.
        rounds: 1 or 2.

    Returns:
        (V', 3) float64 vertices and (F', 3) uint32 faces.

    Example:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(subdivisions=4)
        >>> len(subdivided_from_coarse(ball.vertices, ball.faces, 4000, rounds=1)[1])
        4000
    """
    vertices, faces = decimated(vertices, faces, n_faces / 4**rounds)
    for _ in range(rounds):
        vertices, faces = subdivided(vertices, faces, vertex_normals(vertices, faces))
        # Midpoints leave creases along the old edges; a limit surface has none.
        vertices = np.stack([smoothed(vertices[:, axis], faces, 1) for axis in range(3)], axis=1)
    return vertices, faces
