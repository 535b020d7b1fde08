"""meshio.Mesh."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.meshes.arrays import TakenApart
from gcnd.meshes.normals import Motion, renewed_columns
from gcnd.meshes.registry import unknown_mesh

__all__ = ["take_apart"]

_CARRIED = ("vertex", "line")
"""Blocks that hold no faces: they stay as they are, and their points move along."""


def take_apart(mesh: Any) -> TakenApart:
    """Takes a meshio Mesh apart: all its blocks of triangles, in their order, are one surface.

    Blocks of points and lines are carried along. Point, cell and field data, sets and blocks stay as they are; normals
    among the point data are made anew.

    Raises:
        MeshError: It has other blocks: moving only the surface of a volume would damage its cells.
    """
    import meshio

    if not isinstance(mesh, meshio.Mesh):
        raise unknown_mesh(mesh, "of another meshio object, pass its mesh")
    others = sorted({block.type for block in mesh.cells} - {"triangle", *_CARRIED})
    if others:
        raise MeshError(
            f"the meshio mesh has cells other than triangles: {', '.join(others)}",
            "keep the triangle blocks: meshio.Mesh(mesh.points, {'triangle': mesh.get_cells_type('triangle')})",
        )
    blocks = [np.asarray(block.data) for block in mesh.cells if block.type == "triangle"]
    faces = np.concatenate(blocks) if blocks else np.zeros((0, 3), dtype=np.int64)
    points = np.array(mesh.points)

    def rebuild(vertices: NDArray[np.float64]) -> Any:
        result = copy.deepcopy(mesh)
        result.points = vertices.astype(points.dtype if points.dtype.kind == "f" else np.float64)
        values = {name: np.asarray(column) for name, column in mesh.point_data.items()}
        result.point_data.update(renewed_columns(values, Motion(points, result.points, faces)))
        return result

    return TakenApart(points, faces, rebuild)
