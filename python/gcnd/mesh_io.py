"""Files and other libraries' meshes in and out.

Whatever goes in comes out as the same kind with moved vertices: vertex order, faces, colours, texture
coordinates, attributes and metadata stay. Vertex normals are made anew, never left stale.
"""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gcnd.errors import GcndError, MeshError, MeshWarning
from gcnd.formats.atomic import write_atomic, write_hint
from gcnd.formats.beside import resolver_beside
from gcnd.formats.build import build
from gcnd.formats.export import encode
from gcnd.formats.glb import check_glb
from gcnd.formats.glb_scene import read_glb_shape
from gcnd.formats.names import check_name
from gcnd.formats.obj import read_obj
from gcnd.formats.off import read_off
from gcnd.formats.parsed import DAMAGED_HINT, ParsedMesh
from gcnd.formats.ply import read_ply
from gcnd.formats.referred import copies_of_referred
from gcnd.formats.rewrite import BYTE_ORDER_MARK, rewrite
from gcnd.formats.scene import merge_scene
from gcnd.formats.stl import read_stl
from gcnd.memory import available_bytes
from gcnd.meshes.arrays import MeshArrays, Shape, checked
from gcnd.meshes.normals import Motion
from gcnd.meshes.registry import take_apart

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "FILE_WARNINGS",
    "SUPPORTED",
    "MeshArrays",
    "Shape",
    "check_input_path",
    "check_output_path",
    "load",
    "read_shape",
    "save",
    "to_arrays",
]

MeshPath: TypeAlias = "str | os.PathLike[str]"
Result = TypeVar("Result")

_READERS: Mapping[str, Callable[..., ParsedMesh]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".off": read_off,
}
_OTHER_HINTS = {
    ".gltf": "; export it again as .glb, which is glTF in one file",
    **dict.fromkeys(
        (".xyz", ".pts", ".pcd", ".las", ".laz", ".e57", ".asc"),
        "; a point cloud must be meshed first, as by Poisson reconstruction in MeshLab",
    ),
}
_WITH_POLYGONS = (".ply", ".obj", ".off")
SUPPORTED: tuple[str, ...] = (*_READERS, ".glb")
"""The file extensions that can be read and written."""

FILE_WARNINGS = "file_warnings"
"""In the metadata of a mesh: what is odd about the file that it was read from, in sentences."""


def to_arrays(mesh: Any, *, triangulate: bool = False) -> tuple[MeshArrays, Callable[[ArrayLike], Any]]:
    """Takes any accepted mesh apart into arrays, and returns how to put moved vertices back.

    The input is never changed, and the arrays share no memory with it.

    Args:
        mesh: A trimesh.Trimesh, pyvista.PolyData, meshio.Mesh or open3d TriangleMesh, legacy or of tensors; a pair
            (vertices (V, 3), faces (F, 3)) of numpy arrays, torch tensors or lists; or the path of a mesh file.
        triangulate: Whether faces of four corners and more, of a pair, a PolyData, a meshio.Mesh or a file, are split
            into triangles; all but a file come back with their own faces.

    Returns:
        The arrays, and a function that takes vertices (V, 3) and returns the same kind of mesh with them and with all
        else that the input has, in its dtype and on its device; for a path, a Trimesh. Vertices given as integers come
        back as float64.

    Raises:
        MeshError: If it is none of these, has no faces, has faces that are not triangles, refers to
            vertices that do not exist, or has a coordinate that is not finite; and all that `load` raises.

    Choice: docs/denoising.md#libraries has what each kind keeps.

    Example:
        >>> arrays, rebuild = to_arrays(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
        >>> vertices, faces = rebuild(arrays.vertices + 1.0)
        >>> vertices[0].tolist()
        [1.0, 1.0, 1.0]
    """
    if isinstance(mesh, str | os.PathLike):
        mesh = load(mesh, triangulate=triangulate)
    taken = take_apart(mesh, triangulate=triangulate)
    arrays = checked(taken.vertices, taken.faces)
    return arrays, lambda vertices: taken.rebuild(_same_shape(vertices, arrays))


def read_shape(mesh: Any) -> Shape:
    """Takes the shape of any accepted mesh, to be looked at and not to be put together again.

    Nothing is refused that only a result could not hold: the meshes of a .glb scene may differ in materials, colours
    and attributes, and faces may have more than three corners. Vertices and triangles are those of `to_arrays`.

    Args:
        mesh: As `to_arrays` takes it.

    Returns:
        Its arrays; its faces of more than three corners, split into triangles; and its attributes by face, which a file
        or a Trimesh has.

    Raises:
        MeshError: As `to_arrays` does.

    Example:
        >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        >>> shape = read_shape((square, [[0, 1, 2, 3]]))
        >>> shape.n_faces, shape.arrays.faces.tolist()
        (1, [[0, 1, 2], [0, 2, 3]])
    """
    if isinstance(mesh, str | os.PathLike):
        path = Path(mesh)
        return _read(path, lambda data: _shape_of(data, path))
    taken = take_apart(mesh, triangulate=True)
    attributes = getattr(mesh, "face_attributes", {})
    return Shape(checked(taken.vertices, taken.faces), taken.polygons, attributes)


def load(path: MeshPath, *, shape_only: bool = False, triangulate: bool = False) -> trimesh.Trimesh:
    """Reads a triangle mesh with its vertices and faces in exactly the file's order.

    Nothing is merged, removed or repaired. A vertex with several texture coordinates is repeated behind all
    others, since a mesh object holds one per vertex. Of a glTF scene the meshes are placed and joined where
    that loses nothing. Normals, PLY elements other than vertices and faces, and animations are not kept.

    Args:
        path: A .ply, .obj, .stl, .off or .glb file.
        shape_only: Of a .glb scene, takes only positions, faces and attributes ``_NAME``, so that parts of different
            materials fit together, as is enough for `save` with ``like``.
        triangulate: Whether faces of four corners and more, in .ply, .obj and .off, are split into triangles with their
            colours and attributes; `save` with ``like`` writes them whole again. ``metadata["polygons"]`` is then how
            many faces the file has.

    Returns:
        The mesh, coordinates in file units.

    Raises:
        MeshError: If the file is missing, of another kind, cut off or damaged; if it holds no faces, or a
            face that is not a triangle (named by its number); or a coordinate that is not finite.

    Warns:
        MeshWarning: A few bytes follow the last face of a binary STL.

    Example:
        >>> from gcnd.mesh_io import load  # doctest: +SKIP
        >>> load("scan.ply").vertices.shape  # doctest: +SKIP
        (34834, 3)
    """
    path = Path(path)
    return _read(path, lambda data: _built(data, path, shape_only, triangulate))


def save(mesh: Any, path: MeshPath, *, like: MeshPath | None = None) -> None:
    """Writes a mesh, whole or not at all, in the format that the extension names.

    With ``like``, a file of the same format is written again with this mesh's positions: its normals, where it has any,
    are made anew, and all the rest stays byte for byte, in GLB value for value. Files it refers to are copied to the
    folder of `path`.

    Coordinates get 64 bits in PLY when the mesh was read from a file that had them, and in every format
    where 32 bits would move a vertex by more than 10⁻³ mean edge lengths (see `needs_float64`): STL is then
    text, and GLB keeps its offset in the node. OBJ and OFF text always reads back exactly. OBJ brings its
    .mtl and a copy of its texture, named after it; where another file has such a name, with a number behind.

    Args:
        mesh: A trimesh.Trimesh, or a pair (vertices, faces).
        path: A .ply, .obj, .stl, .off or .glb file; an existing one is replaced.
        like: The file that the mesh was read from; of another format than `path`, it does nothing.

    Raises:
        MeshError: If the extension is none of these, the folder does not exist or cannot be written to, or
            the format cannot hold an attribute of the mesh. What stood at `path` then still does.
    """
    import trimesh

    path = Path(path)
    check_output_path(path, *([] if like is None else [like]))
    files = None if like is None else _written_again(mesh, Path(like), path)
    if not isinstance(mesh, trimesh.Trimesh):
        arrays, _ = to_arrays(mesh)
        mesh = trimesh.Trimesh(arrays.vertices, arrays.faces.astype(np.int64), process=False)
    try:
        for name, data in (files or encode(mesh, path)).items():
            if name != path:
                name.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(name, data)
    except OSError as error:
        raise MeshError(f"cannot write {path}: {error.strerror or error}", write_hint(error)) from error


def _written_again(mesh: Any, source: Path, path: Path) -> dict[Path, bytes] | None:
    """Contents by path, as `encode` has them, of the file written again; None in another format."""
    if source.suffix.lower() != path.suffix.lower():
        return None
    extension = _known_extension(path)
    arrays, _ = to_arrays(mesh)

    def change(data: bytes) -> tuple[bytes, bytes]:
        parsed = read_glb_shape(data) if extension == ".glb" else _parsed(data, extension, triangulate=True)
        if len(parsed.vertices) != len(arrays.vertices) or not np.array_equal(parsed.faces, arrays.faces):
            raise MeshError("it has other faces than the mesh", "name the file that the mesh was read from")
        own = parsed.source_vertex
        n_own = len(arrays.vertices) if own is None else int(own.max()) + 1
        faces = parsed.faces if own is None else own[parsed.faces]
        motion = Motion(parsed.vertices[:n_own], arrays.vertices[:n_own], faces, parsed.polygons)
        return data, rewrite(data, extension, motion)

    data, changed = _read(source, change)
    return {**copies_of_referred(data, source, path), path: changed}


def check_input_path(path: MeshPath) -> None:
    """Checks that a file may be a mesh, before anything is said of where its result goes.

    Args:
        path: The file.

    Raises:
        MeshError: It is a folder, its extension is not supported, or no file can have such a name.
    """
    path = Path(path)
    check_name(path)
    if path.is_dir():
        raise MeshError(f"{path} is a folder, not a mesh file", "name a file in it")
    _known_extension(path)


def check_output_path(path: MeshPath, *others: MeshPath, is_mesh: bool = True) -> None:
    """Checks that a file can be written to `path`, to be called before any long work.

    Args:
        path: Where the file will be written.
        others: Files of the run that it must not replace, first of all its input; they need not be there.
        is_mesh: Whether it is a mesh, whose extension says the format.

    Raises:
        MeshError: If the extension is not supported; the folder does not exist or is not writable; `path` is
            a folder, a device, a pipe or a write-protected file; no file can have such a name; or it is one of
            ``others``, under whatever name. Of what is no mesh, a plain `GcndError`.
    """
    path = Path(path)
    error = MeshError if is_mesh else GcndError
    for each in (path, *map(Path, others)):
        check_name(each, error)
    if path.is_dir():
        raise error(f"{path} is a folder, not a file", "add a file name to it")
    if path.exists() and not path.is_file():
        raise error(f"{path} is a device or a pipe, which a file would replace", "name a file")
    if is_mesh:
        _known_extension(path)
    folder = Path(os.path.realpath(path)).parent
    if not folder.is_dir():
        raise error(f"cannot write {path}: the folder {folder} does not exist", f"mkdir -p {folder}")
    if any(_is_same_file(path, Path(other)) for other in others):
        raise error(
            f"{path} is the input itself, or another file of this run",
            "choose another name; the input is never changed",
        )
    if not os.access(folder, os.W_OK | os.X_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise error(f"cannot write {path}: permission denied", "choose another folder or name")


def _is_same_file(path: Path, other: Path) -> bool:
    if path.exists() and other.exists():
        return os.path.samefile(path, other)
    return os.path.realpath(path) == os.path.realpath(other)


def _known_extension(path: Path) -> str:
    extension = path.suffix.lower()
    if extension not in SUPPORTED:
        what = f"unknown mesh format '{extension}'" if extension else "no file extension"
        hint = f"supported: {', '.join(SUPPORTED)}"
        raise MeshError(f"{path}: {what}", f"{hint}{_OTHER_HINTS.get(extension, '')}")
    return extension


def _read(path: Path, parse: Callable[[bytes], Result]) -> Result:
    """What ``parse`` makes of a file's bytes; an error names the file and its format."""
    check_input_path(path)
    extension = path.suffix.lower()
    data = _read_bytes(path)
    try:
        return parse(data)
    except MeshError as error:
        raise MeshError(f"cannot read {path} as {extension[1:].upper()}: {error}", error.hint) from error
    except Exception as error:  # whatever a parser trips over is a fault of the file, not of its reader
        reason = f"{type(error).__name__}: {error}"
        raise MeshError(f"cannot read {path} as {extension[1:].upper()}: {reason}", DAMAGED_HINT) from error


def _parsed(data: bytes, extension: str, triangulate: bool) -> ParsedMesh:
    """What the reader of a format other than GLB makes of a file."""
    options = {"triangulate": triangulate} if extension in _WITH_POLYGONS else {}
    parsed = _READERS[extension](_without_mark(data, extension), **options)
    if parsed.polygons is not None:
        parsed.metadata["polygons"] = parsed.polygons.n_faces
    return parsed


def _built(data: bytes, path: Path, shape_only: bool, triangulate: bool) -> trimesh.Trimesh:
    extension = path.suffix.lower()
    material: Any = None
    if extension == ".glb":
        check_glb(data)
        parsed, material = (read_glb_shape(data), None) if shape_only else _read_glb(data, path)
    else:
        parsed = _parsed(data, extension, triangulate)
    _warn(parsed, path)
    return build(parsed, checked(parsed.vertices, parsed.faces), material, path)


def _shape_of(data: bytes, path: Path) -> Shape:
    extension = path.suffix.lower()
    if extension == ".glb":
        check_glb(data)
        parsed = read_glb_shape(data, resolver_beside(path.absolute().parent).get)
    else:
        parsed = _parsed(data, extension, triangulate=True)
    _warn(parsed, path)
    return Shape(checked(parsed.vertices, parsed.faces), parsed.polygons, parsed.face_attributes)


def _read_bytes(path: Path) -> bytes:
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


def _without_mark(data: bytes, extension: str) -> bytes:
    """The text behind a byte order mark, as some editors put it in front; binary STL may begin with any bytes."""
    is_text = extension != ".stl" or data[3:8].lower() == b"solid"
    return data.removeprefix(BYTE_ORDER_MARK) if is_text else data


def _read_glb(data: bytes, path: Path) -> tuple[ParsedMesh, Any]:
    import trimesh

    resolver = resolver_beside(path.absolute().parent)
    scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", resolver=resolver, process=False)
    return merge_scene(scene)


def _warn(parsed: ParsedMesh, path: Path) -> None:
    """Tells what is odd about a file; its mesh knows it too, for reports."""
    if parsed.oddity is not None:
        told = f"{path}: {parsed.oddity}"
        parsed.metadata[FILE_WARNINGS] = [told]
        # Seen from the caller of what reads the file.
        warnings.warn(told, MeshWarning, stacklevel=6)


def _same_shape(vertices: ArrayLike, arrays: MeshArrays) -> NDArray[np.float64]:
    moved = np.array(vertices, dtype=np.float64)
    if moved.shape != arrays.vertices.shape:
        raise MeshError(f"moved vertices have shape {moved.shape}, not {arrays.vertices.shape}")
    return moved
