"""Files and other libraries' meshes in and out; the only user of trimesh.

Whatever goes in comes out as the same kind with moved vertices: vertex order, faces, colours, texture
coordinates, attributes and metadata stay. Vertex normals are dropped, never left stale.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gcnd import _geom
from gcnd.errors import MeshError
from gcnd.formats.atomic import write_atomic, write_hint
from gcnd.formats.export import encode, texture_colors
from gcnd.formats.glb import check_glb
from gcnd.formats.obj import read_obj
from gcnd.formats.off import read_off
from gcnd.formats.parsed import DAMAGED_HINT, ParsedMesh, polygon_error
from gcnd.formats.ply import read_ply
from gcnd.formats.scene import merge_scene
from gcnd.formats.stl import read_stl
from gcnd.memory import available_bytes

if TYPE_CHECKING:
    import trimesh

__all__ = ["SUPPORTED", "MeshArrays", "check_output_path", "load", "save", "to_arrays"]

MeshPath: TypeAlias = "str | os.PathLike[str]"

_READERS: Mapping[str, Callable[[bytes], ParsedMesh]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".off": read_off,
}
SUPPORTED: tuple[str, ...] = (*_READERS, ".glb")
"""The file extensions that can be read and written."""

_STALE_AFTER_MOVING = ("nx", "ny", "nz")

LARGEST_COORDINATE = 1e150
"""Beyond it squares of lengths leave the range of numbers."""

_MOST_IDS = 2**32 - 1

_LARGEST_FILE_BESIDE = 1 << 30
"""Bytes of a material or texture."""


@dataclass(frozen=True)
class MeshArrays:
    """Holds a mesh as the two arrays that the geometry core takes.

    Attributes:
        vertices: float64 (V, 3), C order, finite, mesh units.
        faces: uint32 (F, 3), C order, F ≥ 1, vertex ids anticlockwise seen from outside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.uint32]

    def welded(self) -> tuple[MeshArrays, NDArray[np.uint32]]:
        """Joins vertices at exactly the same position.

        Returns:
            The mesh with each position once, and for each vertex of this mesh its vertex there (V,): with positions
            ``moved`` of the former, ``moved[ids]`` are those of this mesh.

        Choice: docs/choices.md#welding.

        Example:
            >>> arrays, _ = to_arrays(([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]], [[3, 1, 2]]))
            >>> mesh, ids = arrays.welded()
            >>> len(mesh.vertices), mesh.faces.tolist(), ids.tolist()
            (3, [[0, 1, 2]], [0, 1, 2, 0])
        """
        representatives, ids = _geom.weld(self.vertices)
        return MeshArrays(self.vertices[representatives], ids[self.faces]), ids


def to_arrays(mesh: Any) -> tuple[MeshArrays, Callable[[ArrayLike], Any]]:
    """Takes any accepted mesh apart into arrays, and returns how to put moved vertices back.

    The input is never changed, and the arrays share no memory with it.

    Args:
        mesh: A trimesh.Trimesh; a pair (vertices (V, 3), faces (F, 3)) of numpy arrays, torch tensors or
            lists; or the path of a mesh file.

    Returns:
        The arrays, and a function that takes vertices (V, 3) and returns the same kind of mesh with them: a
        Trimesh with the colours, texture coordinates, attributes and metadata of the input (also for a
        path), or a pair with the dtype and device of the input. Vertices given as integers come back as
        float64.

    Raises:
        MeshError: If it is none of these, has no faces, has faces that are not triangles, refers to
            vertices that do not exist, or has a coordinate that is not finite; and all that `load` raises.

    Example:
        >>> arrays, rebuild = to_arrays(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
        >>> vertices, faces = rebuild(arrays.vertices + 1.0)
        >>> vertices[0].tolist()
        [1.0, 1.0, 1.0]
    """
    import trimesh

    if isinstance(mesh, str | os.PathLike):
        mesh = load(mesh)
    if isinstance(mesh, trimesh.Trimesh):
        arrays = _checked(np.array(mesh.vertices), np.array(mesh.faces))
        return arrays, lambda vertices: _moved(mesh, _same_shape(vertices, arrays))
    if isinstance(mesh, tuple | list) and len(mesh) == 2:
        arrays = _checked(_as_numpy(mesh[0], "vertices"), _as_numpy(mesh[1], "faces"))
        return arrays, lambda vertices: _like_pair(mesh, _same_shape(vertices, arrays))
    raise MeshError(
        f"cannot take a mesh from {type(mesh).__module__}.{type(mesh).__qualname__}",
        "pass a trimesh.Trimesh, a pair (vertices, faces), or a path; of a scene, pass scene.to_mesh()",
    )


def load(path: MeshPath) -> trimesh.Trimesh:
    """Reads a triangle mesh with its vertices and faces in exactly the file's order.

    Nothing is merged, removed or repaired. A vertex with several texture coordinates is repeated behind all
    others, since a mesh object holds one per vertex. Of a glTF scene the meshes are placed and joined where
    that loses nothing. Normals, PLY elements other than vertices and faces, and animations are not kept.

    Args:
        path: A .ply, .obj, .stl, .off or .glb file.

    Returns:
        The mesh, coordinates in file units.

    Raises:
        MeshError: If the file is missing, of another kind, cut off or damaged; if it holds no faces, or a
            face that is not a triangle (named by its number); or a coordinate that is not finite.

    Example:
        >>> from gcnd.mesh_io import load  # doctest: +SKIP
        >>> load("scan.ply").vertices.shape  # doctest: +SKIP
        (34834, 3)
    """
    path = Path(path)
    extension = _known_extension(path)
    data = _read_bytes(path)
    try:
        if extension == ".glb":
            parsed, material = _read_glb(data, path)
        else:
            parsed, material = _READERS[extension](data), None
        arrays = _checked(parsed.vertices, parsed.faces)
        return _build(parsed, arrays, material, path)
    except MeshError as error:
        raise MeshError(f"cannot read {path} as {extension[1:].upper()}: {error}", error.hint) from error
    except Exception as error:  # whatever a parser trips over is a fault of the file, not of its reader
        reason = f"{type(error).__name__}: {error}"
        raise MeshError(f"cannot read {path} as {extension[1:].upper()}: {reason}", DAMAGED_HINT) from error


def save(mesh: Any, path: MeshPath) -> None:
    """Writes a mesh, whole or not at all, in the format that the extension names.

    Coordinates get 64 bits in PLY when the mesh was read from a file that had them, and in every format
    where 32 bits would move a vertex by more than 10⁻³ mean edge lengths (see `needs_float64`): STL is then
    text, and GLB keeps its offset in the node. OBJ and OFF text always reads back exactly. OBJ brings its
    .mtl and a copy of its texture, named after it.

    Args:
        mesh: A trimesh.Trimesh, or a pair (vertices, faces).
        path: A .ply, .obj, .stl, .off or .glb file; an existing one is replaced.

    Raises:
        MeshError: If the extension is none of these, the folder does not exist or cannot be written to, or
            the format cannot hold an attribute of the mesh. What stood at `path` then still does.
    """
    import trimesh

    path = Path(path)
    check_output_path(path)
    if not isinstance(mesh, trimesh.Trimesh):
        arrays, _ = to_arrays(mesh)
        mesh = trimesh.Trimesh(arrays.vertices, arrays.faces.astype(np.int64), process=False)
    try:
        for name, data in encode(mesh, path).items():
            write_atomic(name, data)
    except OSError as error:
        raise MeshError(f"cannot write {path}: {error.strerror or error}", write_hint(error)) from error


def check_output_path(path: MeshPath, input_path: MeshPath | None = None) -> None:
    """Checks that a mesh can be written to `path`, to be called before any long work.

    Args:
        path: Where the mesh will be written.
        input_path: The file it is made from, or None.

    Raises:
        MeshError: If the extension is not supported; the folder does not exist or is not writable; `path` is
            a folder or a write-protected file; or it is the input itself, under whatever name.
    """
    path = Path(path)
    _known_extension(path)
    folder = Path(os.path.realpath(path)).parent
    if path.is_dir():
        raise MeshError(f"{path} is a folder, not a file", "add a file name to it")
    if not folder.is_dir():
        raise MeshError(f"cannot write {path}: the folder {folder} does not exist", f"mkdir -p {folder}")
    both_exist = input_path is not None and path.exists() and os.path.exists(input_path)
    if both_exist and os.path.samefile(path, str(input_path)):
        raise MeshError(f"{path} is the input itself", "choose another name; the input is never changed")
    if not os.access(folder, os.W_OK | os.X_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise MeshError(f"cannot write {path}: permission denied", "choose another folder or name")


def _known_extension(path: Path) -> str:
    extension = path.suffix.lower()
    if extension not in SUPPORTED:
        what = f"unknown mesh format '{extension}'" if extension else "no file extension"
        raise MeshError(f"{path}: {what}", f"supported: {', '.join(SUPPORTED)}")
    return extension


def _read_bytes(path: Path) -> bytes:
    if path.is_dir():
        raise MeshError(f"{path} is a folder, not a mesh file")
    if path.exists() and not path.is_file():
        # A device or a pipe may never end.
        raise MeshError(f"{path} is no regular file", "write the mesh to a file first")
    free = available_bytes()
    if free is not None and path.is_file() and path.stat().st_size > free:
        raise MeshError(
            f"{path} has {path.stat().st_size / 1e9:.1f} GB, and {free / 1e9:.1f} GB of memory are free",
            "close other programs, cut the mesh into parts, or use a machine with more memory",
        )
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"no such file: {path}", "check the spelling and the folder") from None
    except OSError as error:
        raise MeshError(f"cannot read {path}: {error.strerror or error}") from error
    if not data:
        raise MeshError(f"{path} is empty", DAMAGED_HINT)
    return data


def _read_glb(data: bytes, path: Path) -> tuple[ParsedMesh, Any]:
    import trimesh

    check_glb(data)
    resolver = _files_beside(path.absolute().parent)
    scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", resolver=resolver, process=False)
    return merge_scene(scene)


def _files_beside(folder: Path) -> Any:
    """Gives a reader what a mesh file refers to: ordinary files in its folder or below, of a bounded size."""
    import trimesh

    class FilesBeside(trimesh.resolvers.FilePathResolver):  # type: ignore[misc, unused-ignore]
        def get(self, name: str) -> bytes:
            home = folder.resolve()
            # Others write full paths of their own machines: the file of that name beside the mesh is meant.
            for candidate in (name.strip(), os.path.split(name.strip())[-1]):
                path = (home / candidate).resolve()
                if not (path.is_relative_to(home) and path.is_file()):
                    continue
                if path.stat().st_size > _LARGEST_FILE_BESIDE:
                    raise ValueError(f"{path} has more than {_LARGEST_FILE_BESIDE:,} bytes")
                return path.read_bytes()
            raise FileNotFoundError(name)

    return FilesBeside(str(folder))


def _build(parsed: ParsedMesh, arrays: MeshArrays, material: Any, path: Path) -> trimesh.Trimesh:
    """Makes the trimesh object; colours and texture go where trimesh keeps them."""
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
    resolver = _files_beside(folder)
    simple_material: Any = trimesh.visual.material.SimpleMaterial
    parse_library: Any = trimesh.exchange.obj.parse_mtl
    if "materials" in parsed.metadata:
        parsed.metadata["material_libraries"] = [str(folder / name) for name in parsed.material_libraries]
    material: Any = None
    # A missing or broken material costs the look, not the shape: go on without it.
    for library in parsed.material_libraries if parsed.material is not None else ():
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


def _as_numpy(values: Any, what: str) -> NDArray[Any]:
    if _is_torch(values):
        values = values.detach().cpu()
        # numpy has no bfloat16, and every float that torch has fits in 64 bits.
        values = (values.double() if values.is_floating_point() else values).numpy()
    try:
        array = np.array(values)
    except ValueError:
        lengths = [len(row) if hasattr(row, "__len__") else 1 for row in values]
        bad = next((i for i, length in enumerate(lengths) if length != 3), 0)
        if what == "faces":
            raise polygon_error(bad, lengths[bad]) from None
        raise MeshError(f"vertex {bad} has {lengths[bad]} coordinates, not 3") from None
    if array.dtype.kind not in "iuf":
        raise MeshError(f"{what} are of type {array.dtype}, not numbers")
    return array


def _is_torch(values: Any) -> bool:
    # By name: torch is heavy, and whoever holds a tensor has imported it already.
    return type(values).__module__.partition(".")[0] == "torch"


def _checked(vertices: NDArray[Any], faces: NDArray[Any]) -> MeshArrays:
    """Checks shapes, indices and coordinates; an error names the first offender."""
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(f"vertices have shape {vertices.shape}, not (V, 3)")
    if faces.size == 0:
        raise MeshError("the mesh has no faces", "a point cloud must be meshed first")
    if faces.ndim != 2 or faces.shape[1] != 3:
        if faces.ndim == 2 and faces.shape[1] > 3:
            raise polygon_error(0, faces.shape[1])
        raise MeshError(f"faces have shape {faces.shape}, not (F, 3)")
    if faces.dtype.kind not in "iu":
        raise MeshError(f"faces are of type {faces.dtype}, not integers")
    for count, what in ((len(vertices), "vertices"), (len(faces), "faces")):
        if count > _MOST_IDS:
            raise MeshError(
                f"{count:,} {what} are too many, allowed: {_MOST_IDS:,}", "cut the mesh into parts"
            )
    outside = (faces < 0) | (faces >= len(vertices))
    if outside.any():
        face_id, corner = (int(i) for i in np.argwhere(outside)[0])
        raise MeshError(
            f"face {face_id} refers to vertex {int(faces[face_id, corner])}, and the mesh has "
            f"{len(vertices)} vertices (counted from 0)",
            DAMAGED_HINT,
        )
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    is_bad = ~np.isfinite(points).all(axis=1)
    if is_bad.any():
        vertex_id = int(np.argmax(is_bad))
        position = tuple(points[vertex_id].tolist())
        raise MeshError(
            f"vertex {vertex_id} is not finite: {position}", "remove it, with the faces around it"
        )
    is_far = ~(np.abs(points) <= LARGEST_COORDINATE).all(axis=1)
    if is_far.any():
        vertex_id = int(np.argmax(is_far))
        raise MeshError(
            f"vertex {vertex_id} is at {tuple(points[vertex_id].tolist())}, "
            f"allowed: coordinates up to {LARGEST_COORDINATE:g}",
            "scale the mesh to a size near 1",
        )
    return MeshArrays(points, np.ascontiguousarray(faces, dtype=np.uint32))


def _same_shape(vertices: ArrayLike, arrays: MeshArrays) -> NDArray[np.float64]:
    moved = np.array(vertices, dtype=np.float64)
    if moved.shape != arrays.vertices.shape:
        raise MeshError(f"moved vertices have shape {moved.shape}, not {arrays.vertices.shape}")
    return moved


def _moved(mesh: trimesh.Trimesh, vertices: NDArray[np.float64]) -> trimesh.Trimesh:
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


def _like_pair(pair: Any, vertices: NDArray[np.float64]) -> tuple[Any, Any]:
    """The pair with new vertices, each member in its own library, dtype and device."""
    old_vertices, faces = pair
    if _is_torch(old_vertices):
        import torch

        dtype = old_vertices.dtype if old_vertices.is_floating_point() else torch.float64
        new: Any = torch.as_tensor(vertices).to(device=old_vertices.device, dtype=dtype)
    else:
        kind = np.asarray(old_vertices).dtype
        new = vertices.astype(kind if kind.kind == "f" else np.float64)
    return new, faces.clone() if _is_torch(faces) else np.array(faces)
