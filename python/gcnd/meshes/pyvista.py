"""pyvista.PolyData."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.meshes.arrays import TakenApart
from gcnd.meshes.normals import Motion, renewed_columns
from gcnd.meshes.registry import unknown_mesh

__all__ = ["take_apart"]

_TRIANGULATE = "pass mesh.triangulate()"


def take_apart(mesh: Any) -> TakenApart:
    """Takes a PolyData of triangles apart; points keep their 32 or 64 bits.

    Point, cell and field data stay. Normals are made anew: those that are active, and point data called so.

    Raises:
        MeshError: It is another data set, or has cells other than triangles.
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
    faces = _triangles(mesh)
    points = np.array(mesh.points)

    def rebuild(vertices: NDArray[np.float64]) -> Any:
        copy = mesh.copy(deep=True)
        copy.points = vertices.astype(points.dtype)
        if len(faces):
            _renew_normals(copy, Motion(points, np.asarray(copy.points), faces))
        return copy

    return TakenApart(points, faces, rebuild)


def _triangles(mesh: Any) -> NDArray[np.int64]:
    """The faces (F, 3), or an error that names the first that is no triangle."""
    corners = np.diff(np.asarray(mesh.GetPolys().GetOffsetsArray()))
    wrong = np.flatnonzero(corners != 3)
    if len(wrong):
        raise MeshError(
            f"face {wrong[0]} of the PolyData has {corners[wrong[0]]} corners, not 3",
            _TRIANGULATE,
        )
    return np.array(mesh.faces, dtype=np.int64).reshape(-1, 4)[:, 1:]


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
