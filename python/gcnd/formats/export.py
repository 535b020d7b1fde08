"""From a trimesh object to the bytes of a file and of the files it refers to."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gcnd.formats.obj_write import write_obj
from gcnd.formats.off import write_off
from gcnd.formats.parsed import ParsedMesh
from gcnd.formats.ply import write_ply
from gcnd.formats.stl import write_stl

if TYPE_CHECKING:
    import trimesh

__all__ = ["encode", "needs_float64", "texture_colors"]

FLOAT32_TOLERANCE = 1e-3
"""How far 32 bits may move a vertex, in mean edge lengths, before 64 are written."""

_NO_TEXT = re.compile("[\ud800-\udfff]")


def needs_float64(vertices: NDArray[np.float64], faces: NDArray[Any]) -> bool:
    """Tells whether 32-bit coordinates would damage the shape.

    True when max_i |v_i − float32(v_i)|_∞ > 10⁻³ · mean edge length. Coordinates far from the origin are the
    usual reason: at an offset of 10⁶ neighbouring 32-bit numbers are 0.06 apart.

    Args:
        vertices: float64 (V, 3).
        faces: int (F, 3).

    Returns:
        Whether 64 bits are needed.

    Example:
        >>> vertices, faces = np.array([[0.1, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
        >>> needs_float64(vertices, faces), needs_float64(vertices + 1e6, faces)
        (False, True)
    """
    if not len(vertices) or not len(faces):
        return False
    with np.errstate(over="ignore"):
        lost = np.abs(vertices - vertices.astype(np.float32)).max()
    corners = vertices[faces]
    mean_edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    return bool(lost > FLOAT32_TOLERANCE * mean_edge)


def encode(mesh: trimesh.Trimesh, path: Path) -> dict[Path, bytes]:
    """Turns a mesh into the contents of `path`, chosen by its extension, and of the files beside it.

    Args:
        mesh: The mesh; it is not changed.
        path: Where the mesh will be written.

    Returns:
        Contents by path; files that the mesh file refers to come first, the mesh file last.

    Raises:
        gcnd.errors.MeshError: If the format cannot hold an attribute of the mesh.
    """
    parsed = _parsed(mesh)
    extension = path.suffix.lower()
    is_wide = needs_float64(parsed.vertices, parsed.faces)
    if extension == ".glb":
        return {path: _encode_glb(mesh, is_wide)}
    if extension == ".obj":
        return _encode_obj(mesh, parsed, path)
    if extension == ".off":
        return {path: write_off(parsed)}
    if extension == ".stl":
        return {path: write_stl(parsed, as_text=is_wide)}
    texture = _image_path(mesh)
    comments = [] if texture is None else [f"TextureFile {_relative(texture, path.parent)}"]
    is_wide = is_wide or bool(parsed.metadata.get("float64"))
    return {path: write_ply(parsed, float64=is_wide, comments=comments)}


def _parsed(mesh: trimesh.Trimesh) -> ParsedMesh:
    n_vertices, n_faces = len(mesh.vertices), len(mesh.faces)
    visual: Any = mesh.visual
    uv = _rows(getattr(visual, "uv", None), n_vertices)
    vertex_colors = visual.vertex_colors if visual.kind == "vertex" else texture_colors(mesh)
    return ParsedMesh(
        vertices=np.array(mesh.vertices, dtype=np.float64),
        faces=np.array(mesh.faces, dtype=np.int64),
        vertex_colors=_rgba(vertex_colors, n_vertices),
        face_colors=_rgba(visual.face_colors if visual.kind == "face" else None, n_faces),
        uv=None if uv is None else uv[:, :2].astype(np.float64),
        vertex_attributes=_attributes(mesh.vertex_attributes, n_vertices),
        face_attributes=_attributes(mesh.face_attributes, n_faces),
        metadata=dict(mesh.metadata),
    )


def texture_colors(mesh: trimesh.Trimesh) -> NDArray[Any] | None:
    """Returns the colours per vertex that a mesh has beside its texture, or None.

    Args:
        mesh: The mesh.

    Returns:
        (V, 3) or (V, 4), or None.
    """
    visual: Any = mesh.visual
    colors: NDArray[Any] | None = visual.vertex_attributes.get("color") if visual.kind == "texture" else None
    return colors


def _rows(values: Any, n: int) -> NDArray[Any] | None:
    """The values as an array, if there are n rows of them."""
    array = None if values is None else np.asarray(values)
    return array if array is not None and array.ndim == 2 and len(array) == n else None


def _rgba(values: Any, n: int) -> NDArray[np.uint8] | None:
    rows = _rows(values, n)
    return None if rows is None else rows.astype(np.uint8)


def _attributes(attributes: Any, n: int) -> dict[str, NDArray[Any]]:
    arrays = {str(name): np.asarray(values) for name, values in attributes.items()}
    return {name: array for name, array in arrays.items() if array.ndim and len(array) == n}


def _encode_glb(mesh: trimesh.Trimesh, is_wide: bool) -> bytes:
    """glTF positions have 32 bits: an offset too large for them becomes the translation of the node."""
    # trimesh writes normals when they happen to be cached; a fresh copy has none.
    clean: Any = mesh.copy()
    colors = texture_colors(mesh)
    if colors is not None:
        clean.visual.vertex_attributes["color"] = np.array(colors)
    scene: Any = clean.scene()
    if is_wide:
        offset = np.round((mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2.0)
        clean.vertices = np.asarray(mesh.vertices) - offset
        scene = clean.scene()
        matrix = np.eye(4)
        matrix[:3, 3] = offset
        scene.graph.update(frame_to=scene.graph.nodes_geometry[0], matrix=matrix)
    data: bytes = scene.export(file_type="glb", include_normals=False)
    return data


def _encode_obj(mesh: trimesh.Trimesh, parsed: ParsedMesh, path: Path) -> dict[Path, bytes]:
    """The OBJ file with its material library and texture, named after it and after no other file that is there."""
    files: dict[Path, bytes] = {}
    names: Sequence[str] = ()
    if "material_id" in parsed.face_attributes and "materials" in parsed.metadata:
        # Several materials: the object cannot hold them, so the file refers to where they came from.
        names = parsed.metadata["materials"]
        libraries = parsed.metadata.get("material_libraries", [])
        parsed.material_libraries = [_relative(Path(library), path.parent) for library in libraries]
    material = getattr(mesh.visual, "material", None)
    if not names and material is not None:
        own = _with_text_name(path)
        simple = material.to_simple() if hasattr(material, "to_simple") else material
        texture = _image_path(mesh)
        library = _material_library(simple, own, texture, files)
        if library is not None:
            place = _add_beside(files, own.with_suffix(".mtl"), library)
            parsed.material_libraries, names = [place.name], [own.stem.replace(" ", "_")]
    files[path] = write_obj(parsed, names)
    return files


def _with_text_name(path: Path) -> Path:
    """The path with "_" for every byte of its name that is no UTF-8, so that the name can stand in a file."""
    return path.with_name(_NO_TEXT.sub("_", path.name))


def _material_library(
    material: Any, path: Path, texture: Path | None, files: dict[Path, bytes]
) -> bytes | None:
    """The text of the .mtl file; the texture, if there is one, is added to `files`."""
    if not hasattr(material, "to_obj"):
        return None
    written, name = material.to_obj(name=path.stem.replace(" ", "_"))
    text = str(written.pop(f"{name}.mtl").decode("utf-8"))
    for image_name, image in written.items():
        # The image is copied as it is where its file is known: encoding it again would lose quality.
        suffix = Path(image_name).suffix if texture is None else texture.suffix
        content = image if texture is None else texture.read_bytes()
        place = _add_beside(files, path.with_name(f"{name}_texture{suffix}"), content)
        text = text.replace(f"map_Kd {image_name}", f"map_Kd {place.name}")
    return (text + "\n").encode("utf-8")


def _add_beside(files: dict[Path, bytes], path: Path, content: bytes) -> Path:
    """Adds a file of this name, or of the first of name_2, name_3, … that is free; one of this content is used."""
    numbered = (path.with_name(f"{path.stem}_{number}{path.suffix}") for number in count(2))
    places = chain([path], numbered)
    place = next(place for place in places if not os.path.lexists(place) or _holds(place, content))
    if not os.path.lexists(place):
        files[place] = content
    return place


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and os.access(path, os.R_OK) and path.read_bytes() == content


def _image_path(mesh: trimesh.Trimesh) -> Path | None:
    """File of the mesh's texture, if it was read from one that still exists."""
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "image", None)
    name = getattr(image, "info", {}).get("file_path") if image is not None else None
    path = Path(name) if name else None
    return path if path is not None and path.is_absolute() and path.is_file() else None


def _relative(path: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive on Windows
        return path.as_posix()
