"""PLY, text and binary: read with every value per vertex and per face, written with 32 or 64 bits.

Elements other than "vertex" and "face" are not kept, nor are normals: they would be stale once the vertices
move.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import (
    DAMAGED_HINT,
    ParsedMesh,
    polygon_error,
    rgba_from_values,
    split_seams,
)
from gcnd.formats.ply_header import PlyElement, PlyHeader, PlyProperty, parse_header
from gcnd.formats.ply_ragged import keep_even_lists, layout_text, read_ragged, take_polygons
from gcnd.formats.ply_uniform import INDEX_NAMES, has_face_indices, uniform_numbers, uniform_rows

__all__ = ["read_ply", "write_ply"]

_UV_NAMES = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))
_RGB, _NORMAL = ("red", "green", "blue"), ("nx", "ny", "nz")

Columns = dict[str, NDArray[Any]]


def read_ply(data: bytes, *, triangulate: bool = False) -> ParsedMesh:
    """Reads a PLY file.

    A vertex whose faces give it several texture coordinates is repeated at the end of the vertices (see
    `split_seams`); otherwise vertices and faces are the file's, in the file's order. A list of which one vertex or face
    has more values than another is left out.

    Args:
        data: The whole file.
        triangulate: Whether faces of four corners and more are split; else they are refused.

    Returns:
        The mesh. `metadata["float64"]` is true when its header declares coordinates of 64 bits.

    Raises:
        MeshError: If the file is no PLY file, is cut off, or has a face that is not a triangle.
    """
    header = parse_header(data)
    read = _read_text if header.byte_order is None else _read_binary
    columns = read(data, header, triangulate)
    if "tristrips" in columns and "face" not in columns:
        raise MeshError(
            "it holds triangle strips and no faces",
            "open it in MeshLab and save it again, which makes triangles",
        )
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    keep_even_lists(vertex)
    if not all(axis in vertex for axis in "xyz"):
        raise MeshError("it has no vertices with x, y and z", "it may hold something other than a mesh")
    index_name = next((name for name in INDEX_NAMES if name in face), None)
    parsed = ParsedMesh(
        vertices=np.column_stack([vertex.pop(axis) for axis in "xyz"]).astype(np.float64),
        faces=np.zeros((0, 3), np.int64),
        texture=header.texture,
    )
    lengths = face.pop(f"{index_name} length", None)
    if index_name is not None and lengths is not None:
        if not triangulate and (lengths != 3).any():
            bad = int(np.argmax(lengths != 3))
            raise polygon_error(bad, int(lengths[bad]))
        take_polygons(parsed, face.pop(index_name).astype(np.int64), lengths, face)
    elif index_name is not None and face[index_name].ndim == 2:
        parsed.faces = face.pop(index_name).astype(np.int64)
    is_double = any(p.name == "x" and p.dtype == "f8" for e in header.elements for p in e.properties)
    if is_double:
        parsed.metadata["float64"] = True
    _take_values(parsed, vertex, face)
    return parsed


def _take_values(parsed: ParsedMesh, vertex: Columns, face: Columns) -> None:
    """Sorts the remaining columns into colours, texture coordinates and attributes."""
    for columns in (vertex, face):
        for name in _NORMAL:
            columns.pop(name, None)
    parsed.vertex_colors = _pop_colors(vertex)
    if parsed.vertex_colors is None:
        # A mesh object has one kind of colour; with both, the faces' stay as attributes.
        parsed.face_colors = _pop_colors(face)
    for names in _UV_NAMES:
        if all(name in vertex for name in names):
            parsed.uv = np.column_stack([vertex.pop(name) for name in names]).astype(np.float64)
            break
    parsed.vertex_attributes = vertex
    texcoord = face.get("texcoord")
    if parsed.uv is None and texcoord is not None and texcoord.shape == (len(parsed.faces), 6):
        corner_uv = face.pop("texcoord").reshape(-1, 2).astype(np.float64)
        values, value_id = np.unique(corner_uv, axis=0, return_inverse=True)
        parsed.faces, source_vertex, vertex_value = split_seams(
            parsed.faces, value_id.reshape(parsed.faces.shape).astype(np.int64), len(parsed.vertices)
        )
        parsed.repeat_vertices(source_vertex)
        parsed.uv = np.where(vertex_value[:, None] >= 0, values[vertex_value], 0.0)
    parsed.face_attributes = face


def _pop_colors(columns: Columns) -> NDArray[np.uint8] | None:
    if not all(name in columns and columns[name].ndim == 1 for name in _RGB):
        return None
    names = [*_RGB, "alpha"] if "alpha" in columns else list(_RGB)
    return rgba_from_values(np.column_stack([columns.pop(name) for name in names]))


def _read_binary(data: bytes, header: PlyHeader, triangulate: bool) -> dict[str, Columns]:
    """Reads every element of a binary file into columns, (n,) for a number and (n, k) for a list.

    Of an element whose lists differ in length, columns are as `read_ragged` has them.
    """
    columns: dict[str, Columns] = {}
    position = header.data_start
    order = header.byte_order or "<"
    for element in header.elements:
        is_split = triangulate and has_face_indices(element)
        rows = None if is_split else uniform_rows(data, position, element, order)
        if rows is None:
            columns[element.name], position = read_ragged(data, position, element, order)
            continue
        # Native byte order and own memory, so that nothing keeps the whole file alive.
        columns[element.name] = {
            p.name: rows[p.name].astype(rows[p.name].dtype.newbyteorder("=")) for p in element.properties
        }
        position += rows.nbytes
    if position < len(data) and data[position:].strip():
        raise MeshError(f"{len(data) - position} bytes follow the data its header announces", DAMAGED_HINT)
    return columns


def _read_text(data: bytes, header: PlyHeader, triangulate: bool) -> dict[str, Columns]:
    """Reads every element of a text file into columns, as `_read_binary` does."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            numbers = np.fromstring(data[header.data_start :].decode("ascii"), dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            raise MeshError("its data holds something that is not a number", DAMAGED_HINT) from None
    columns: dict[str, Columns] = {}
    position = 0
    for element in header.elements:
        is_split = triangulate and has_face_indices(element)
        table = None if is_split else uniform_numbers(numbers, position, element)
        if table is None:
            layout = layout_text(numbers, position, element)
            found = {p.name: numbers[layout.all_places(p.name, 1)] for p in element.properties}
            position = layout.end
        else:
            rows, column_of = table
            found = {p.name: rows[:, column_of[p.name]] for p in element.properties}
            position += rows.size
        values = {p.name: _as_declared(found[p.name], _text_dtype(p), element, p) for p in element.properties}
        columns[element.name] = values if table is not None else layout.with_lengths(values)
    if position < len(numbers):
        raise MeshError(
            f"{len(numbers) - position} numbers follow the data its header announces", DAMAGED_HINT
        )
    return columns


def _as_declared(
    numbers: NDArray[np.float64], dtype: str, element: PlyElement, prop: PlyProperty
) -> NDArray[Any]:
    """Text numbers in the type that the header gives them, if that holds them."""
    kind = np.dtype(dtype)
    if kind.kind == "f":
        with np.errstate(over="ignore"):
            return numbers.astype(kind)
    # The ends as floats: 2⁶³ − 1 rounds up to one that is too large.
    fits = (numbers >= float(np.iinfo(kind).min)) & (numbers < float(np.iinfo(kind).max) + 1.0)
    is_bad = ~(fits & (numbers == np.floor(numbers)))
    if is_bad.any():
        first = tuple(np.argwhere(is_bad)[0])
        raise MeshError(
            f"'{prop.name}' of {element.name} {first[0]} is {numbers[first]:g}, which is no {kind.name}",
            DAMAGED_HINT,
        )
    return numbers.astype(kind)


def _text_dtype(prop: PlyProperty) -> str:
    # Text coordinates carry the digits they were written with, whatever the header calls them.
    return "f8" if prop.name in ("x", "y", "z") else prop.dtype


def write_ply(mesh: ParsedMesh, *, float64: bool, comments: Sequence[str] = ()) -> bytes:
    """Writes a binary little-endian PLY file, with colours, texture coordinates and attributes.

    Args:
        mesh: The mesh; its metadata is not written.
        float64: Whether coordinates get 64 bits (`double`) or 32 (`float`).
        comments: Header comments, such as "TextureFile wood.png".

    Returns:
        The whole file.

    Raises:
        MeshError: If an attribute is no array of numbers with one row per vertex or face.
    """
    scalar = "<f8" if float64 else "<f4"
    vertex: list[tuple[str, NDArray[Any]]] = [
        (axis, mesh.vertices[:, i].astype(scalar)) for i, axis in enumerate("xyz")
    ]
    vertex += _color_columns(mesh.vertex_colors)
    if mesh.uv is not None:
        vertex += [("s", mesh.uv[:, 0].astype(scalar)), ("t", mesh.uv[:, 1].astype(scalar))]
    vertex += mesh.vertex_attributes.items()
    face: list[tuple[str, NDArray[Any]]] = [("vertex_indices", mesh.faces.astype("<i4"))]
    face += _color_columns(mesh.face_colors)
    face += mesh.face_attributes.items()
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    vertex_lines, vertex_rows = _pack("vertex", vertex, len(mesh.vertices))
    face_lines, face_rows = _pack("face", face, len(mesh.faces))
    header += [*vertex_lines, *face_lines, "end_header", ""]
    return "\n".join(header).encode("utf-8", errors="replace") + vertex_rows + face_rows


def _color_columns(colors: NDArray[np.uint8] | None) -> list[tuple[str, NDArray[Any]]]:
    if colors is None:
        return []
    return [(name, colors[:, i]) for i, name in enumerate((*_RGB, "alpha"))]


_PLY_FROM_DTYPE = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
_WIDENED = {"b1": "u1", "i8": "i4", "u8": "u4", "f2": "f4"}


def _pack(name: str, columns: Sequence[tuple[str, NDArray[Any]]], n: int) -> tuple[list[str], bytes]:
    """Header lines and data of one element."""
    lines = [f"element {name} {n}"]
    fields: list[Any] = []
    packed: list[tuple[str, NDArray[Any] | int]] = []
    for column_name, values in columns:
        code = np.asarray(values).dtype.str[1:]
        code = _WIDENED.get(code, code)
        is_word = column_name.isascii() and column_name.isprintable() and " " not in column_name
        if code not in _PLY_FROM_DTYPE or len(values) != n or values.ndim > 2 or not is_word:
            raise MeshError(
                f"{name} attribute '{column_name}' of shape {np.shape(values)} and type "
                f"{np.asarray(values).dtype} cannot be written as PLY",
                "remove that attribute, or save as another format",
            )
        values = _narrow(values, code, f"{name} attribute '{column_name}'")
        if values.ndim == 2:
            if values.shape[1] > 255:
                raise MeshError(f"{name} attribute '{column_name}' has {values.shape[1]} columns, over 255")
            lines.append(f"property list uchar {_PLY_FROM_DTYPE[code]} {column_name}")
            fields += [(f"{column_name} length", "<u1"), (column_name, "<" + code, (values.shape[1],))]
            packed += [(f"{column_name} length", values.shape[1]), (column_name, values)]
        else:
            lines.append(f"property {_PLY_FROM_DTYPE[code]} {column_name}")
            fields.append((column_name, "<" + code))
            packed.append((column_name, values))
    rows = np.zeros(n, dtype=fields)
    for field_name, value in packed:
        rows[field_name] = value
    return lines, rows.tobytes()


def _narrow(values: NDArray[Any], code: str, what: str) -> NDArray[Any]:
    """Converts to the type that is written, or raises when a value does not fit."""
    with np.errstate(over="ignore"):
        narrowed = values.astype(code)
    if values.dtype.kind in "iu" and not np.array_equal(narrowed, values):
        raise MeshError(f"{what} has values beyond 32 bits, which PLY cannot hold", "save as another format")
    return narrowed
