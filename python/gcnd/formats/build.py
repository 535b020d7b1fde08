"""From what a file holds to a trimesh object."""

from __future__ import annotations

import io
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd.formats.beside import libraries_of_line, resolver_beside
from gcnd.formats.parsed import ParsedMesh

if TYPE_CHECKING:
    import trimesh

    from gcnd.meshes.arrays import MeshArrays

__all__ = ["build"]


def build(parsed: ParsedMesh, arrays: MeshArrays, material: Any, path: Path) -> trimesh.Trimesh:
    """Makes the trimesh object; colours and texture go where trimesh keeps them.

    Args:
        parsed: What the file holds.
        arrays: Its vertices and faces, checked.
        material: Its material, where its reader has made one; else that which it names is looked for.
        path: The file.

    Returns:
        The mesh.
    """
    import trimesh

    visuals: Any = trimesh.visual
    if material is None:
        material = _material(parsed, path)
    mesh = trimesh.Trimesh(arrays.vertices, arrays.faces.astype(np.int64), process=False)
    mesh.metadata.update(parsed.metadata)
    mesh.vertex_attributes.update(parsed.vertex_attributes)
    mesh.face_attributes.update(parsed.face_attributes)
    has_colors = parsed.vertex_colors is not None or parsed.face_colors is not None
    if parsed.uv is not None or (material is not None and not has_colors):
        material = visuals.material.SimpleMaterial() if material is None else material
        visual = visuals.TextureVisuals(uv=parsed.uv, material=material)
        if parsed.vertex_colors is not None:
            visual.vertex_attributes["color"] = parsed.vertex_colors
        mesh.visual = visual
    elif parsed.vertex_colors is not None:
        mesh.visual = visuals.ColorVisuals(mesh, vertex_colors=parsed.vertex_colors)
    elif parsed.face_colors is not None:
        mesh.visual = visuals.ColorVisuals(mesh, face_colors=parsed.face_colors)
    if parsed.face_colors is not None and (parsed.uv is not None or parsed.vertex_colors is not None):
        channels = zip(("red", "green", "blue", "alpha"), parsed.face_colors.T, strict=True)
        mesh.face_attributes.update({name: channel.copy() for name, channel in channels})
    return mesh


def _material(parsed: ParsedMesh, path: Path) -> Any:
    """The one material or texture that a PLY or OBJ file names, if it can be read."""
    import trimesh

    folder = path.absolute().parent
    resolver = resolver_beside(folder)
    simple_material: Any = trimesh.visual.material.SimpleMaterial
    parse_library: Any = trimesh.exchange.obj.parse_mtl
    libraries = [name for line in parsed.material_libraries for name in libraries_of_line(folder, line)]
    if "materials" in parsed.metadata:
        parsed.metadata["material_libraries"] = [str(folder / name) for name in libraries]
    material: Any = None
    # A missing or broken material costs the look, not the shape: go on without it.
    for library in libraries if parsed.material is not None else ():
        with suppress(OSError, ValueError, KeyError, TypeError):
            found = parse_library(resolver.get(library), resolver=resolver)
            material = material or simple_material(**found[parsed.material])
    if parsed.texture is not None:
        with suppress(ImportError, OSError, ValueError):
            from PIL import Image

            picture = Image.open(io.BytesIO(resolver.get(parsed.texture)))
            picture.info["file_path"] = parsed.texture
            material = simple_material(image=picture)
    image = getattr(material, "image", None)
    if image is not None and image.info.get("file_path"):
        image.info["file_path"] = str(folder / image.info["file_path"])
    return material
