"""pyvista.PolyData."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import DAMAGED_HINT, check_ids, triangles_of
from gcnd.formats.polygons import Polygons
from gcnd.meshes.arrays import TakenApart
from gcnd.meshes.normals import Motion, renewed_columns
from gcnd.meshes.registry import unknown_mesh

__all__ = ["take_apart"]

_TRIANGULATE = "pass mesh.triangulate()"
_SPLIT = "triangulate=True splits such faces for the work and returns them whole; or pass mesh.triangulate()"


def take_apart(mesh: Any, *, triangulate: bool = False) -> TakenApart:
    """Takes a PolyData apart; points keep their 32 or 64 bits. With ``triangulate`` faces may have more corners than
    three; the mesh comes back with its own.

    Point, cell and field data stay. Normals are made anew: those that are active, and point data called so.

    Raises:
        MeshError: It is another data set, or has cells other than triangles, or than faces.
    """
    import pyvista

    if not isinstance(mesh, pyvista.PolyData):
        raise unknown_mesh(mesh, "of another pyvista data set, pass mesh.extract_surface().triangulate()")
    if mesh.n_strips:
        raise MeshError(f"the PolyData has {mesh.n_strips} triangle strips", _TRIANGULATE)
    if mesh.n_verts or mesh.n_lines:
        raise MeshError(
            f"the PolyData has {mesh.n_verts} vertex cells and {mesh.n_lines} lines beside its faces",
            "pass pyvista.PolyData(mesh.points, faces=mesh.faces), which leaves them out",
        )
    points = np.array(mesh.points)
    faces, polygons = _triangles(mesh, points, triangulate)

    def rebuild(vertices: NDArray[np.float64]) -> Any:
        copy = mesh.copy(deep=True)
        copy.points = vertices.astype(points.dtype)
        if len(faces):
            _renew_normals(copy, Motion(points, np.asarray(copy.points), faces, polygons))
        return copy

    return TakenApart(points, faces, rebuild, polygons)


def _triangles(
    mesh: Any, points: NDArray[Any], triangulate: bool
) -> tuple[NDArray[np.int64], Polygons | None]:
    """The triangles (T, 3), and of which faces they are parts if some have more corners; without ``triangulate`` an
    error names the first of those."""
    cells = mesh.GetPolys()
    ends = np.array(cells.GetOffsetsArray(), dtype=np.int64)
    lengths = ends[1:] - ends[:-1]
    ids = np.array(cells.GetConnectivityArray(), dtype=np.int64)
    wrong = np.flatnonzero(lengths < 3 if triangulate else lengths != 3)
    if len(wrong):
        corners = lengths[wrong[0]]
        hint = _SPLIT if corners > 3 else DAMAGED_HINT
        raise MeshError(f"face {wrong[0]} of the PolyData has {corners} corners, not 3", hint)
    check_ids(ids, lengths, len(points))
    corner_ids, polygons = triangles_of(points.astype(np.float64), ids, lengths)
    return ids[corner_ids], polygons


def _renew_normals(mesh: Any, motion: Motion) -> None:
    point_data = {name: np.asarray(mesh.point_data[name]) for name in mesh.point_data.keys()}  # noqa: SIM118
    new = renewed_columns(point_data, motion)
    active = mesh.point_data.active_normals_name
    if active is not None and active not in new:
        new[active] = motion.vertex_normals(point_data[active])
    for name, values in new.items():
        # In place, so that what is active stays so, in the same order.
        mesh.point_data[name][:] = values
    of_cells = mesh.cell_data.active_normals_name
    if of_cells is not None:
        mesh.cell_data[of_cells][:] = motion.face_normals(np.array(mesh.cell_data[of_cells]))
