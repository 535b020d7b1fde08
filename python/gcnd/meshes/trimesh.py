"""trimesh.Trimesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gcnd.formats.export import texture_colors
from gcnd.meshes.arrays import TakenApart
from gcnd.meshes.registry import unknown_mesh

if TYPE_CHECKING:
    import trimesh

__all__ = ["take_apart"]

_STALE_AFTER_MOVING = ("nx", "ny", "nz")


def take_apart(mesh: Any) -> TakenApart:
    """Takes a Trimesh apart; a primitive comes back as a free mesh.

    trimesh makes normals anew by itself when they are asked for.
    """
    import trimesh

    if not isinstance(mesh, trimesh.Trimesh):
        raise unknown_mesh(mesh, "of a scene, pass scene.to_mesh()")

    def rebuild(vertices: NDArray[np.float64]) -> trimesh.Trimesh:
        # A primitive such as trimesh.primitives.Box has no free vertices.
        copy: Any = mesh.to_mesh() if hasattr(mesh, "to_mesh") else mesh.copy()
        copy.vertices = vertices
        colors = texture_colors(mesh)
        if colors is not None:
            # trimesh's copy of a texture forgets the colours beside it.
            copy.visual.vertex_attributes["color"] = np.array(colors)
        for name in _STALE_AFTER_MOVING:
            copy.vertex_attributes.pop(name, None)
        # trimesh's own PLY reader leaves the whole file in there, with the old positions and normals.
        copy.metadata.pop("_ply_raw", None)
        result: trimesh.Trimesh = copy
        return result

    return TakenApart(np.array(mesh.vertices), np.array(mesh.faces), rebuild)
