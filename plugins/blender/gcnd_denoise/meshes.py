"""Reading and writing the positions of Blender's meshes; everything else of them stays."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from .arrays import Triangles
from .errors import Failure

__all__ = ["check_object", "kept_vertices", "notes", "positions", "sharing", "triangles", "write"]


def check_object(obj: bpy.types.Object | None) -> bpy.types.Object:
    """Checks that there is an object whose mesh can be worked on.

    Raises:
        Failure: There is none, it is not in Object Mode, or it belongs to another file.
    """
    if obj is None or obj.type != "MESH":
        raise Failure("No mesh object is active", "click one in the 3D view")
    if obj.mode != "OBJECT":
        raise Failure(f"{obj.name} is in {obj.mode.replace('_', ' ').title()} Mode", "change to Object Mode")
    if obj.library is not None or obj.data.library is not None:
        raise Failure(
            f"{obj.name} is linked from another file",
            "Object > Relations > Make Local > Selected Objects and Data",
        )
    return obj


def positions(mesh: bpy.types.Mesh) -> NDArray[np.float32]:
    """Returns positions (V, 3); of a mesh with shape keys, those of its basis."""
    found = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    points = mesh.shape_keys.reference_key.data if mesh.shape_keys else mesh.vertices
    points.foreach_get("co", found)
    return found.reshape(-1, 3)


def triangles(mesh: bpy.types.Mesh) -> Triangles:
    """Returns the mesh with its quads and polygons split into triangles, as Blender draws them."""
    mesh.calc_loop_triangles()
    faces = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", faces)
    return Triangles(positions(mesh), faces.reshape(-1, 3))


def write(mesh: bpy.types.Mesh, moved: NDArray[np.float32]) -> None:
    """Writes positions (V, 3); every shape key moves by as much as the basis does."""
    if mesh.shape_keys:
        basis = mesh.shape_keys.reference_key
        way = moved - positions(mesh)
        for key in mesh.shape_keys.key_blocks:
            points = np.empty(moved.size, dtype=np.float32)
            key.data.foreach_get("co", points)
            key.data.foreach_set("co", moved.ravel() if key == basis else points + way.ravel())
    mesh.vertices.foreach_set("co", moved.ravel())
    mesh.update()


def kept_vertices(obj: bpy.types.Object, mesh: bpy.types.Mesh, group: str) -> NDArray[np.bool_] | None:
    """Returns which vertices are in a vertex group of the object with a weight above 0 (V,); None without a group.

    Raises:
        Failure: The object has no such group.
    """
    if not group:
        return None
    if group not in obj.vertex_groups:
        raise Failure(f"{obj.name} has no vertex group {group!r}", "choose another one to keep, or none")
    index = obj.vertex_groups[group].index
    weights = ((g.weight for g in vertex.groups if g.group == index) for vertex in mesh.vertices)
    return np.fromiter((any(w > 0.0 for w in each) for each in weights), dtype=bool, count=len(mesh.vertices))


def sharing(mesh: bpy.types.Mesh) -> int:
    """Counts the objects that show a mesh."""
    return sum(obj.data == mesh for obj in bpy.data.objects)


def notes(obj: bpy.types.Object) -> list[str]:
    """Says what about an object its user may not expect of the result."""
    found = []
    if len(obj.modifiers):
        found.append("the base mesh was denoised, before its modifiers")
    scale = np.abs(obj.scale)
    if scale.max() > 1.001 * scale.min():
        found.append("the object's scale differs by axis; apply the scale first (Ctrl A) for a better result")
    return found
