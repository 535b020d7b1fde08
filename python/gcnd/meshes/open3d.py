"""open3d's TriangleMesh, the legacy one and the one of tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.meshes.arrays import TakenApart
from gcnd.meshes.normals import Motion
from gcnd.meshes.registry import unknown_mesh

__all__ = ["take_apart"]


def take_apart(mesh: Any) -> TakenApart:
    """Takes a TriangleMesh of either kind apart; a tensor's dtype and device stay.

    Colours, texture coordinates, textures, materials and attributes stay; normals of vertices and triangles are made
    anew where there are any.

    Raises:
        MeshError: It is no TriangleMesh.
    """
    import open3d

    if isinstance(mesh, open3d.geometry.TriangleMesh):
        return _legacy(mesh)
    if isinstance(mesh, open3d.t.geometry.TriangleMesh):
        return _of_tensors(mesh)
    raise unknown_mesh(mesh, "of a point cloud, make a mesh first")


def _legacy(mesh: Any) -> TakenApart:
    from open3d.utility import Vector3dVector

    vertices, faces = np.array(mesh.vertices), np.array(mesh.triangles, dtype=np.int64)

    def rebuild(moved: NDArray[np.float64]) -> Any:
        copy = type(mesh)(mesh)
        copy.vertices = Vector3dVector(moved)
        motion = Motion(vertices, moved, faces)
        if mesh.has_vertex_normals():
            copy.vertex_normals = Vector3dVector(motion.vertex_normals(np.array(mesh.vertex_normals)))
        if mesh.has_triangle_normals():
            copy.triangle_normals = Vector3dVector(motion.face_normals(np.array(mesh.triangle_normals)))
        return copy

    return TakenApart(vertices, faces, rebuild)


def _of_tensors(mesh: Any) -> TakenApart:
    import open3d

    core: Any = open3d.core

    def numbers(tensors: Any, name: str, width: int) -> NDArray[Any]:
        return np.array(tensors[name].cpu().numpy()) if name in tensors else np.zeros((0, width))

    vertices = numbers(mesh.vertex, "positions", 3)
    faces = numbers(mesh.triangle, "indices", 3)

    def rebuild(moved: NDArray[np.float64]) -> Any:
        copy = mesh.clone()
        # open3d's clone forgets the material.
        copy.material = type(mesh.material)(mesh.material)
        positions = moved.astype(vertices.dtype)
        new: dict[str, dict[str, NDArray[Any]]] = {"vertex": {"positions": positions}, "triangle": {}}
        motion = Motion(vertices, positions, faces)
        if "normals" in mesh.vertex:
            new["vertex"]["normals"] = motion.vertex_normals(numbers(mesh.vertex, "normals", 3))
        if "normals" in mesh.triangle:
            new["triangle"]["normals"] = motion.face_normals(numbers(mesh.triangle, "normals", 3))
        for where, columns in new.items():
            for name, values in columns.items():
                getattr(copy, where)[name] = core.Tensor(values, device=mesh.device)
        return copy

    return TakenApart(vertices, faces, rebuild)
