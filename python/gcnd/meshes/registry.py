"""Which adapter a mesh needs."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from gcnd.errors import MeshError
from gcnd.meshes.arrays import TakenApart

__all__ = ["take_apart", "unknown_mesh"]

_ADAPTERS = {
    "trimesh": "gcnd.meshes.trimesh",
    "pyvista": "gcnd.meshes.pyvista",
    "open3d": "gcnd.meshes.open3d",
    "meshio": "gcnd.meshes.meshio",
}
"""By library, the module whose ``take_apart`` takes its objects. A new library is a new file and a line here."""

_WITH_POLYGONS = ("pyvista", "meshio")
"""Libraries whose meshes may have faces of more than three corners; their ``take_apart`` is told ``triangulate``."""


def take_apart(mesh: Any, *, triangulate: bool = False) -> TakenApart:
    """Takes a mesh object or a pair of arrays apart, by the adapter of its library.

    Args:
        mesh: An object of a library that has an adapter, of a class derived from one, or a pair (vertices, faces).
        triangulate: Whether faces may have more corners than three; they are split.

    Returns:
        Its arrays, and how to put it together again.

    Raises:
        MeshError: It is nothing that gcnd knows, or not a triangle mesh.
    """
    if isinstance(mesh, tuple | list) and len(mesh) == 2:
        from gcnd.meshes.pair import take_apart as take_pair

        return take_pair(mesh, triangulate=triangulate)
    for kind in type(mesh).__mro__:
        library = kind.__module__.partition(".")[0]
        if library in _ADAPTERS:
            take: Callable[..., TakenApart] = import_module(_ADAPTERS[library]).take_apart
            return take(mesh, triangulate=triangulate) if library in _WITH_POLYGONS else take(mesh)
    raise unknown_mesh(mesh, "of a scene, pass one mesh")


def unknown_mesh(mesh: Any, hint: str) -> MeshError:
    """Makes the error for an object that is no triangle mesh.

    Args:
        mesh: The object.
        hint: What to do with it.

    Returns:
        The error, which names the object's class.
    """
    return MeshError(
        f"cannot take a mesh from {type(mesh).__module__}.{type(mesh).__qualname__}",
        f"pass a mesh of {', '.join(_ADAPTERS)}, a pair (vertices, faces), or a path; {hint}",
    )
