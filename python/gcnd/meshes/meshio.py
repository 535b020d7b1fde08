"""meshio.Mesh."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import check_ids, polygon_error, triangles_of
from gcnd.formats.polygons import Polygons
from gcnd.meshes.arrays import TakenApart
from gcnd.meshes.normals import Motion, renewed_columns
from gcnd.meshes.registry import unknown_mesh

__all__ = ["take_apart"]

_CARRIED = ("vertex", "line")
"""Blocks that hold no faces: they stay as they are, and their points move along."""

_POLYGONS = ("quad", "polygon")
"""Blocks of faces that are taken with ``triangulate``."""


def take_apart(mesh: Any, *, triangulate: bool = False) -> TakenApart:
    """Takes a meshio Mesh apart: all its blocks of triangles, in their order, are one surface; with ``triangulate``
    those of quads and polygons too.

    Blocks of points and lines are carried along. Point, cell and field data, sets and blocks stay as they are; normals
    among the point data are made anew.

    Raises:
        MeshError: It has other blocks: moving only the surface of a volume would damage its cells.
    """
    import meshio

    if not isinstance(mesh, meshio.Mesh):
        raise unknown_mesh(mesh, "of another meshio object, pass its mesh")
    taken = ("triangle", *_POLYGONS) if triangulate else ("triangle",)
    others = sorted({block.type for block in mesh.cells} - {*taken, *_CARRIED})
    if others:
        raise MeshError(
            f"the meshio mesh has cells other than triangles: {', '.join(others)}",
            "triangulate=True splits such faces for the work and returns them whole"
            if set(others) <= set(_POLYGONS)
            else "keep the triangle blocks: meshio.Mesh(mesh.points, {'triangle': mesh.get_cells_type('triangle')})",
        )
    points = np.array(mesh.points)
    faces, polygons = _triangles([np.asarray(b.data) for b in mesh.cells if b.type in taken], points)

    def rebuild(vertices: NDArray[np.float64]) -> Any:
        result = copy.deepcopy(mesh)
        result.points = vertices.astype(points.dtype if points.dtype.kind == "f" else np.float64)
        values = {name: np.asarray(column) for name, column in mesh.point_data.items()}
        result.point_data.update(renewed_columns(values, Motion(points, result.points, faces, polygons)))
        return result

    return TakenApart(points, faces, rebuild, polygons)


def _triangles(blocks: list[NDArray[Any]], points: NDArray[Any]) -> tuple[NDArray[Any], Polygons | None]:
    """The triangles (T, 3) of blocks of faces, and of which faces they are parts if some have more corners."""
    if all(block.shape[1] == 3 for block in blocks) or points.ndim != 2 or points.shape[1] != 3:
        # What is wrong with the points is told later.
        triangles = [block[:, :3] for block in blocks]
        return np.concatenate(triangles) if blocks else np.zeros((0, 3), dtype=np.int64), None
    ids = np.concatenate([block.ravel() for block in blocks]).astype(np.int64)
    lengths = np.repeat([block.shape[1] for block in blocks], [len(block) for block in blocks])
    if lengths.min() < 3:
        face_id = int(np.argmax(lengths < 3))
        raise polygon_error(face_id, int(lengths[face_id]))
    check_ids(ids, lengths, len(points))
    corners, polygons = triangles_of(points.astype(np.float64), ids, lengths)
    return ids[corners], polygons
