"""The volume inside closed meshes, and giving it back to a mesh that lost some."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.start import near_1

__all__ = ["check_closed", "enclosed_volumes", "open_edges", "restored_volume", "tell_nobody"]

Points = NDArray[np.float64]
Faces = NDArray[np.uint32]

_STEPS = 20
"""Newton steps at most; three or four are enough unless vertices are held."""

_TOLERANCE = 1e-12
"""Of the sum of the tetrahedra's absolute volumes: what rounding leaves."""


def tell_nobody() -> None:
    """Lets the work go on."""


def open_edges(faces: Faces) -> int:
    """Counts the edges across which faces do not close: those of one face, or of two that disagree on the outside.

    Args:
        faces: Vertex ids (F, 3).

    Returns:
        The number of edges that are not run through as often in one direction as in the other.

    Example:
        >>> open_edges(np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32))
        0
    """
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    low, high = ends.min(axis=1), ends.max(axis=1)
    _, edge = np.unique(low * (int(faces.max(initial=0)) + 1) + high, return_inverse=True)
    direction = np.sign(ends[:, 1] - ends[:, 0])
    return int(np.count_nonzero(np.bincount(edge.reshape(-1), weights=direction)))


def check_closed(faces: Faces) -> None:
    """Checks that a mesh has an inside.

    Args:
        faces: Vertex ids (F, 3), each position one vertex.

    Raises:
        MeshError: If it has a boundary, or neighbours that disagree on what is outside.
    """
    n_open = open_edges(faces)
    if n_open:
        raise MeshError(
            f"the mesh encloses no volume: {n_open} edges lack a face, or their faces disagree on what is outside",
            "preserve_volume is for closed meshes; close the holes or go without it",
        )


def enclosed_volumes(vertices: Points, faces: Faces, body: NDArray[np.int64]) -> Points:
    """Computes the volume inside every body of a closed mesh.

    V = Σ_f p₀ · (p₁ × p₂) / 6 over the body's faces.

    Args:
        vertices: Positions (V, 3), mesh units.
        faces: Vertex ids (F, 3).
        body: Of each vertex, its body (V,).

    Returns:
        Cubic mesh units (B,), negative where faces are clockwise seen from outside.
    """
    volumes: Points = np.bincount(
        body[faces[:, 0]], weights=_tetrahedra(vertices, faces), minlength=int(body.max()) + 1
    ).astype(np.float64)
    return volumes


def restored_volume(
    vertices: Points,
    faces: Faces,
    target: Points,
    free: NDArray[np.bool_],
    limit: Callable[[Points], Points],
    ask: Callable[[], object] = tell_nobody,
) -> Points:
    """Moves a closed mesh along its vertex normals until each body encloses the target's volume.

    v_i ← v_i + t n_i with one t per body, by Newton's method on V(t), which is cubic.

    Args:
        vertices: Positions (V, 3), mesh units.
        faces: Vertex ids (F, 3); closed, see `check_closed`.
        target: Positions (V, 3) whose volumes are wanted.
        free: Vertices that may move (V,).
        limit: Brings positions (V, 3) back to where they are allowed; the volume comes as near as that permits.
        ask: Called before each step and between its parts; what it raises stops the work.

    Returns:
        Positions (V, 3); exactly ``vertices`` where no volume is missing.

    Choice: docs/choices.md#volume.
    """
    is_used = np.isin(np.arange(len(vertices)), faces)[:, None]
    near, doublings = near_1(target, faces)
    if doublings:

        def there(points: Points) -> Points:
            return np.where(is_used, np.ldexp(points, -doublings), vertices)

        def here(points: Points) -> Points:
            return np.ldexp(np.where(is_used, points, 0.0), doublings)

        return there(
            restored_volume(here(vertices), faces, near, free, lambda points: here(limit(there(points))), ask)
        )
    body = _bodies(faces, len(vertices))
    # Of what the faces use: others may be anywhere.
    origin = target[is_used[:, 0]].mean(axis=0)
    ask()
    wanted = enclosed_volumes(target - origin, faces, body)
    gradient = _gradient(vertices - origin, faces)
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    direction = np.divide(gradient, length, out=np.zeros_like(gradient), where=(length > 0) & free[:, None])
    moved = vertices
    for _ in range(_STEPS):
        ask()
        tetrahedra = _tetrahedra(moved - origin, faces)
        n_bodies = len(wanted)
        missing = wanted - np.bincount(body[faces[:, 0]], weights=tetrahedra, minlength=n_bodies)
        size = np.bincount(body[faces[:, 0]], weights=np.abs(tetrahedra), minlength=n_bodies)
        missing[np.abs(missing) <= _TOLERANCE * size] = 0.0
        if not missing.any():
            break
        ask()
        slope = np.bincount(
            body, weights=(_gradient(moved - origin, faces) * direction).sum(axis=1), minlength=n_bodies
        )
        step = np.divide(missing, slope, out=np.zeros_like(missing), where=slope > 0)
        moved = limit(moved + step[body, None] * direction)
    return moved


def _tetrahedra(vertices: Points, faces: Faces) -> Points:
    """Signed volume (F,) between the origin and each face."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    volumes: Points = (a * np.cross(b, c)).sum(axis=1) / 6.0
    return volumes


def _gradient(vertices: Points, faces: Faces) -> Points:
    """∂V/∂v (V, 3): a third of the area vectors of a vertex's faces, by closedness."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    share = np.cross(b - a, c - a) / 6.0
    corners = faces.ravel()
    sums = [
        np.bincount(corners, weights=np.repeat(share[:, axis], 3), minlength=len(vertices))
        for axis in range(3)
    ]
    return np.stack(sums, axis=1)


def _bodies(faces: Faces, n_vertices: int) -> NDArray[np.int64]:
    """Of each vertex, the number of the connected part it belongs to (V,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, columns = faces[:, [0, 1]].T.ravel(), faces[:, [1, 2]].T.ravel()
    links = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n_vertices, n_vertices))
    _, body = connected_components(links.tocsr(), directed=False)
    return np.asarray(body, dtype=np.int64)
