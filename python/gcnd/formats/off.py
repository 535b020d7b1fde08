"""OFF: read and written with colours; normals and texture coordinates of its rarer kinds are not kept."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import (
    DAMAGED_HINT,
    ParsedMesh,
    check_ids,
    polygon_error,
    rgba_from_values,
    triangles_of,
    truncated_error,
)

__all__ = ["KEYWORD", "read_off", "write_off"]

KEYWORD = re.compile(r"(ST)?(C)?(N)?OFF$")


def read_off(data: bytes, *, triangulate: bool = False) -> ParsedMesh:
    """Reads an OFF file (OFF, COFF, NOFF, STOFF and their combinations, as text).

    Args:
        data: The whole file.
        triangulate: Whether faces of four corners and more are split; else they are refused.

    Returns:
        The mesh.

    Raises:
        MeshError: If the file is no OFF file, is cut off, or has a face that is not a triangle.
    """
    text = data.decode("utf-8", errors="replace")
    lines = [
        line for line in (raw.partition("#")[0].strip() for raw in re.split(r"\r\n|[\r\n]", text)) if line
    ]
    keyword, _, rest = lines[0].partition(" ") if lines else ("", "", "")
    kind = KEYWORD.match(keyword)
    if kind is None:
        raise MeshError(
            "it does not start with the word 'OFF'", "check that the extension matches the content"
        )
    if rest.strip().upper().startswith("BINARY"):
        raise MeshError("it is a binary OFF file, which is not supported", "save it as text OFF or as PLY")
    lines = [rest, *lines[1:]] if rest.strip() else lines[1:]
    try:
        n_vertices, n_faces = (int(word) for word in lines[0].split()[:2])
    except (IndexError, ValueError):
        raise MeshError("the line of vertex and face counts is missing", DAMAGED_HINT) from None
    if n_vertices < 0 or n_faces < 0:
        raise MeshError(f"it announces {n_vertices} vertices and {n_faces} faces", DAMAGED_HINT)
    vertex_rows = [line.split() for line in lines[1 : 1 + n_vertices]]
    face_rows = [line.split() for line in lines[1 + n_vertices : 1 + n_vertices + n_faces]]
    if len(vertex_rows) < n_vertices:
        raise truncated_error("vertices", n_vertices, len(vertex_rows))
    # Normals (N) stand between the position and the colour (C).
    color_start = 6 if kind[3] else 3
    vertices, vertex_colors = _parse_vertices(vertex_rows, color_start, has_color=bool(kind[2]))
    ids, lengths, face_colors = _parse_faces(face_rows, triangulate)
    if len(face_rows) < n_faces:
        raise truncated_error("faces", n_faces, len(face_rows))
    check_ids(ids, lengths, n_vertices)
    corners, polygons = triangles_of(vertices, ids, lengths)
    if face_colors is not None and polygons is not None:
        face_colors = face_colors[polygons.owner]
    return ParsedMesh(
        vertices,
        ids[corners],
        vertex_colors,
        None if vertex_colors is not None else face_colors,
        polygons=polygons,
    )


def _parse_vertices(
    rows: Sequence[Sequence[str]], color_start: int, *, has_color: bool
) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
    for vertex_id, row in enumerate(rows):
        if len(row) < 3:
            raise MeshError(f"vertex {vertex_id} has {len(row)} coordinates, not 3", DAMAGED_HINT)
    vertices = _floats([row[:3] for row in rows], "vertex").reshape(-1, 3)
    colors = _parse_colors([row[color_start : color_start + 4] for row in rows]) if has_color else None
    return vertices, colors


def _parse_faces(
    rows: Sequence[Sequence[str]], triangulate: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8] | None]:
    """Vertex ids of all corners (C,), corners a face (F,), and colours of the faces."""
    lengths = []
    for face_id, row in enumerate(rows):
        if not row[0].isdecimal():
            raise MeshError(f"face {face_id} begins with '{row[0][:40]}', not with 3", DAMAGED_HINT)
        length = int(row[0])
        if length != 3 and not (triangulate and length > 3):
            raise polygon_error(face_id, length)
        if len(row) < 1 + length:
            if length == 3:
                raise polygon_error(face_id, len(row) - 1)
            raise MeshError(f"face {face_id} announces {length} corners and has {len(row) - 1}", DAMAGED_HINT)
        lengths.append(length)
    try:
        words = [word for row, length in zip(rows, lengths, strict=True) for word in row[1 : 1 + length]]
        ids = np.array(words, dtype=np.int64)
    except (ValueError, OverflowError):
        raise MeshError("a face has a corner that is no index", DAMAGED_HINT) from None
    colors = _parse_colors([row[1 + length : 5 + length] for row, length in zip(rows, lengths, strict=True)])
    return ids, np.array(lengths, dtype=np.int64), colors


def _parse_colors(rows: Sequence[Sequence[str]]) -> NDArray[np.uint8] | None:
    """Colours, when every row has three or every row has four channels; otherwise None."""
    if not rows or len(rows[0]) not in (3, 4) or any(len(row) != len(rows[0]) for row in rows):
        return None
    values = _floats(rows, "colour")
    # Integers count to 255 and fractions to 1, so that "1 0 0" is nearly black and "1.0 0 0" is red.
    is_fraction = any("." in word for row in rows for word in row)
    return rgba_from_values(values if is_fraction else values.astype(np.int64))


def _floats(rows: Sequence[Sequence[str]], what: str) -> NDArray[np.float64]:
    try:
        return np.array(rows, dtype=np.float64)
    except ValueError:
        raise MeshError(f"a {what} is not made of numbers", DAMAGED_HINT) from None


def write_off(mesh: ParsedMesh) -> bytes:
    """Writes a text OFF file (COFF when the vertices have colours) whose numbers read back exactly.

    Args:
        mesh: The mesh; texture coordinates, attributes and metadata are not written.

    Returns:
        The whole file.
    """
    vertices: list[list[Any]] = mesh.vertices.tolist()
    faces: list[list[int]] = mesh.faces.tolist()
    if mesh.vertex_colors is not None:
        vertices = [v + c for v, c in zip(vertices, mesh.vertex_colors.tolist(), strict=True)]
    tails: list[list[int]] = [[] for _ in faces] if mesh.face_colors is None else mesh.face_colors.tolist()
    lines = ["COFF" if mesh.vertex_colors is not None else "OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(map(repr, vertex)) for vertex in vertices]
    lines += [" ".join(map(str, [3, *face, *tail])) for face, tail in zip(faces, tails, strict=True)]
    return ("\n".join(lines) + "\n").encode("ascii")
