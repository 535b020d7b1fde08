"""The preview: the object shows a copy of its mesh, and the mesh itself waits unchanged.

All of it is in Blender's data: the copy holds the positions before and after as attributes, and the object points to
its own mesh. So undo, saving and loading keep it whole, and the strength can change without a new run.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from . import meshes
from .arrays import blended, moved_text
from .errors import Failure

__all__ = ["apply", "end", "is_shown", "own_mesh", "refresh", "show"]

_BEFORE, _AFTER = "gcnd_before", "gcnd_after"


def is_shown(obj: bpy.types.Object) -> bool:
    """Says whether an object shows a preview."""
    return obj.gcnd_denoise.own_mesh is not None


def own_mesh(obj: bpy.types.Object) -> bpy.types.Mesh:
    """Returns the mesh that is the object's own, whether or not it shows a preview."""
    return obj.gcnd_denoise.own_mesh or obj.data


def show(obj: bpy.types.Object, after: NDArray[np.float32]) -> str:
    """Shows denoised positions (V, 3) in the mesh's place; returns what they change, in words.

    Raises:
        Failure: The object has no such vertex group as is to be kept.
    """
    mesh = own_mesh(obj)
    # Before anything is made, as it can fail.
    meshes.kept_vertices(obj, obj.data, obj.gcnd_denoise.keep)
    end(obj)
    copy = mesh.copy()
    copy.name = f"{mesh.name} (gcnd preview)"
    for name, values in ((_BEFORE, meshes.positions(mesh)), (_AFTER, after)):
        attribute = copy.attributes.new(name, "FLOAT_VECTOR", "POINT")
        attribute.data.foreach_set("vector", values.ravel())
    obj.gcnd_denoise.own_mesh = mesh
    obj.data = copy
    return _update(obj, *_stored(copy))


def refresh(obj: bpy.types.Object) -> None:
    """Shows the preview with the strength and the group that are set now."""
    found = _stored(obj.data) if is_shown(obj) and obj.mode == "OBJECT" else None
    if found is not None and (not obj.gcnd_denoise.keep or obj.gcnd_denoise.keep in obj.vertex_groups):
        _update(obj, *found)


def end(obj: bpy.types.Object) -> None:
    """Shows the object's own mesh again and removes the copy."""
    if not is_shown(obj):
        return
    copy, obj.data = obj.data, obj.gcnd_denoise.own_mesh
    obj.gcnd_denoise.own_mesh = None
    if copy.users == 0:
        bpy.data.meshes.remove(copy)


def apply(obj: bpy.types.Object) -> str:
    """Gives the object's own mesh the positions of the preview and ends it; returns what changed, in words.

    Raises:
        Failure: The mesh or the preview was edited in between.
    """
    mesh, found = own_mesh(obj), _stored(obj.data)
    if found is None or not np.array_equal(meshes.positions(mesh), found[0]):
        raise Failure("The mesh was edited since the preview was made", "go back and preview it again")
    moved = _moved(obj, *found)
    end(obj)
    meshes.write(mesh, moved)
    return moved_text(found[0], moved)


def _stored(copy: bpy.types.Mesh) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Positions before and after (V, 3) that a preview holds, or None where somebody took them away."""
    found = []
    for name in (_BEFORE, _AFTER):
        attribute = copy.attributes.get(name)
        if attribute is None or (attribute.data_type, attribute.domain) != ("FLOAT_VECTOR", "POINT"):
            return None
        values = np.empty(3 * len(copy.vertices), dtype=np.float32)
        attribute.data.foreach_get("vector", values)
        found.append(values.reshape(-1, 3))
    return found[0], found[1]


def _moved(
    obj: bpy.types.Object, before: NDArray[np.float32], after: NDArray[np.float32]
) -> NDArray[np.float32]:
    keep = meshes.kept_vertices(obj, obj.data, obj.gcnd_denoise.keep)
    return blended(before, after, obj.gcnd_denoise.strength, keep)


def _update(obj: bpy.types.Object, before: NDArray[np.float32], after: NDArray[np.float32]) -> str:
    moved = _moved(obj, before, after)
    meshes.write(obj.data, moved)
    return moved_text(before, moved)
