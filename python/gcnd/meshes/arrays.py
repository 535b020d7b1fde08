"""The two arrays that the geometry core takes, and the checks on the way there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.errors import MeshError
from gcnd.formats.parsed import DAMAGED_HINT, polygon_error
from gcnd.formats.polygons import Polygons

__all__ = ["LARGEST_COORDINATE", "MeshArrays", "Shape", "TakenApart", "checked"]

LARGEST_COORDINATE = 1e150
"""Beyond it squares of lengths leave the range of numbers."""

_MOST_IDS = 2**32 - 1


@dataclass(frozen=True)
class MeshArrays:
    """Holds a mesh as the two arrays that the geometry core takes.

    Attributes:
        vertices: float64 (V, 3), C order, finite, mesh units.
        faces: uint32 (F, 3), C order, F ≥ 1, vertex ids anticlockwise seen from outside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.uint32]

    def welded(self) -> tuple[MeshArrays, NDArray[np.uint32]]:
        """Joins vertices at exactly the same position.

        Returns:
            The mesh with each position once, and for each vertex of this mesh its vertex there (V,): with positions
            ``moved`` of the former, ``moved[ids]`` are those of this mesh.

        Choice: docs/choices.md#welding.

        Example:
            >>> from gcnd.mesh_io import to_arrays
            >>> arrays, _ = to_arrays(([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]], [[3, 1, 2]]))
            >>> mesh, ids = arrays.welded()
            >>> len(mesh.vertices), mesh.faces.tolist(), ids.tolist()
            (3, [[0, 1, 2]], [0, 1, 2, 0])
        """
        representatives, ids = _geom.weld(self.vertices)
        return MeshArrays(self.vertices[representatives], ids[self.faces]), ids


class Shape(NamedTuple):
    """What is known of a mesh that is only looked at.

    Attributes:
        arrays: Vertices and triangles.
        polygons: Which faces of the mesh the triangles stand for, where some have more corners; or None.
        face_attributes: Values by name, a row for each triangle.
    """

    arrays: MeshArrays
    polygons: Polygons | None = None
    face_attributes: Mapping[str, NDArray[Any]] = MappingProxyType({})

    @property
    def n_faces(self) -> int:
        """How many faces the mesh has, each counted once however many corners it has."""
        return len(self.arrays.faces) if self.polygons is None else self.polygons.n_faces


class TakenApart(NamedTuple):
    """What an adapter returns for a mesh.

    Attributes:
        vertices: Numbers (V, 3), as the mesh has them; nothing but their shape's first number is relied on.
        faces: Vertex ids (F, 3), likewise.
        rebuild: Takes float64 vertices (V, 3) and returns a new mesh of the same kind; the old one is left alone.
        polygons: Which faces of the mesh the triangles stand for, where some have more corners; or None.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any]
    rebuild: Callable[[NDArray[np.float64]], Any]
    polygons: Polygons | None = None


def checked(vertices: NDArray[Any], faces: NDArray[Any]) -> MeshArrays:
    """Checks shapes, indices and coordinates, and copies them to the core's types.

    Args:
        vertices: Numbers (V, 3), mesh units.
        faces: Integers (F, 3).

    Returns:
        The mesh; it shares no memory with the arguments where their types differ from the core's.

    Raises:
        MeshError: There are no faces, or something is wrong with one; the first offender is named.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(f"vertices have shape {vertices.shape}, not (V, 3)")
    if faces.size == 0:
        if len(vertices) == 0:
            raise MeshError("the mesh is empty: it has no vertices and no faces", "look at what made it")
        raise MeshError("the mesh has no faces", "a point cloud must be meshed first")
    if faces.ndim != 2 or faces.shape[1] != 3:
        if faces.ndim == 2 and faces.shape[1] > 3:
            raise polygon_error(0, faces.shape[1])
        raise MeshError(f"faces have shape {faces.shape}, not (F, 3)")
    if faces.dtype.kind not in "iu":
        raise MeshError(f"faces are of type {faces.dtype}, not integers")
    for count, what in ((len(vertices), "vertices"), (len(faces), "faces")):
        if count > _MOST_IDS:
            raise MeshError(
                f"{count:,} {what} are too many, allowed: {_MOST_IDS:,}", "cut the mesh into parts"
            )
    outside = (faces < 0) | (faces >= len(vertices))
    if outside.any():
        face_id, corner = (int(i) for i in np.argwhere(outside)[0])
        raise MeshError(
            f"face {face_id} refers to vertex {int(faces[face_id, corner])}, and the mesh has "
            f"{len(vertices)} vertices (counted from 0)",
            DAMAGED_HINT,
        )
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    is_bad = ~np.isfinite(points).all(axis=1)
    if is_bad.any():
        vertex_id = int(np.argmax(is_bad))
        position = tuple(points[vertex_id].tolist())
        is_used = bool((faces == vertex_id).any())
        raise MeshError(
            f"vertex {vertex_id} is not finite: {position}",
            f"remove it, {'with the faces around it' if is_used else 'which no face uses'}",
        )
    is_far = ~(np.abs(points) <= LARGEST_COORDINATE).all(axis=1)
    if is_far.any():
        vertex_id = int(np.argmax(is_far))
        raise MeshError(
            f"vertex {vertex_id} is at {tuple(points[vertex_id].tolist())}, "
            f"allowed: coordinates up to {LARGEST_COORDINATE:g}",
            "scale the mesh to a size near 1",
        )
    return MeshArrays(points, np.ascontiguousarray(faces, dtype=np.uint32))
