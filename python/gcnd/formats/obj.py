"""Wavefront OBJ, reading: vertices in the file's order, with colours, texture coordinates and material names.

Normals, groups, smoothing groups, lines and points are not kept.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import (
    DAMAGED_HINT,
    ParsedMesh,
    polygon_error,
    rgba_from_values,
    split_seams,
    triangles_of,
)

__all__ = ["read_obj"]

_LINE_END = re.compile(r"\r\n|[\r\n]")
"""What other ends of lines Python knows, no OBJ has: a name may hold them."""


@dataclass
class _Lines:
    """The file's lines by keyword, with what is needed to number them."""

    vertices: list[str] = field(default_factory=list)
    vertex_lines: list[int] = field(default_factory=list)
    uv: list[str] = field(default_factory=list)
    faces: list[str] = field(default_factory=list)
    face_lines: list[int] = field(default_factory=list)
    relative: list[tuple[int, int, int]] = field(default_factory=list)
    """(face id, vertices so far, texture coordinates so far) of each face that counts backwards."""
    libraries: list[str] = field(default_factory=list)
    materials: list[tuple[int, str]] = field(default_factory=list)
    """(face id, name) where each material begins."""
    name: str | None = None


def read_obj(data: bytes, *, triangulate: bool = False) -> ParsedMesh:
    """Reads an OBJ file.

    The first vertices are the file's `v` lines in order, used or not; a vertex whose corners have several
    texture coordinates is repeated after them (see `split_seams`).

    Args:
        data: The whole file.
        triangulate: Whether faces of four corners and more are split; else they are refused.

    Returns:
        The mesh. `material` is set when the file uses exactly one; when it uses several,
        `metadata["materials"]` has their names and `face_attributes["material_id"]` says which, −1 for none.

    Raises:
        MeshError: If a line is no number list, a face is not a triangle or refers to something that does
            not exist, with the face and the line.
    """
    lines = _collect(data.decode("utf-8", errors="replace"))
    if not lines.vertices:
        raise MeshError("it has no vertices (v lines)", "it may hold something other than a mesh")
    vertices, colors = _parse_vertices(lines)
    parsed = ParsedMesh(vertices=vertices, faces=np.zeros((0, 3), np.int64), vertex_colors=colors)
    parsed.material_libraries = lines.libraries
    if lines.name:
        parsed.metadata["name"] = lines.name
    if lines.faces:
        ids, uv_ids, lengths = _parse_corners(lines, triangulate)
        corners, parsed.polygons = triangles_of(vertices, ids, lengths)
        faces, corner_uv = ids[corners], uv_ids[corners]
        parsed.faces = faces
        if lines.uv and (corner_uv >= 0).any():
            uv = _parse_uv(lines.uv)
            parsed.faces, source_vertex, vertex_uv = split_seams(faces, corner_uv, len(vertices))
            parsed.repeat_vertices(source_vertex)
            parsed.uv = np.where(vertex_uv[:, None] >= 0, uv[vertex_uv], 0.0)
    _take_materials(parsed, lines)
    return parsed


def _take_materials(parsed: ParsedMesh, lines: _Lines) -> None:
    names = list(dict.fromkeys(name for _, name in lines.materials))
    if len(names) == 1:
        parsed.material = names[0]
    elif names:
        starts = [start for start, _ in lines.materials]
        place = {name: index for index, name in enumerate(names)}
        ids = np.array([-1, *(place[name] for _, name in lines.materials)], dtype=np.int32)
        face_ids = np.arange(len(lines.faces)) if parsed.polygons is None else parsed.polygons.owner
        parsed.face_attributes["material_id"] = ids[np.searchsorted(starts, face_ids, side="right")]
        parsed.metadata["materials"] = names


def _collect(text: str) -> _Lines:
    """Sorts the lines by keyword."""
    lines = _Lines()
    text = text.replace("\\\r\n", " ").replace("\\\n", " ").replace("\t", " ")
    for number, raw in enumerate(_LINE_END.split(text), start=1):
        key, _, rest = raw.strip().partition(" ")
        match key:
            case "v":
                lines.vertices.append(rest)
                lines.vertex_lines.append(number)
            case "f":
                rest = rest.partition("#")[0]
                if "-" in rest:
                    lines.relative.append((len(lines.faces), len(lines.vertices), len(lines.uv)))
                lines.faces.append(rest)
                lines.face_lines.append(number)
            case "vt":
                lines.uv.append(rest)
            case "usemtl":
                lines.materials.append((len(lines.faces), rest.strip()))
            case "mtllib":
                lines.libraries.append(rest.strip())
            case "o":
                lines.name = lines.name or rest.strip()
            case _:
                pass
    return lines


def _parse_vertices(lines: _Lines) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
    """Positions, and colours where every vertex has them (x y z r g b)."""
    rows = [line.split() for line in lines.vertices]
    n_columns = min(len(row) for row in rows)
    if n_columns < 3:
        short = next(i for i, row in enumerate(rows) if len(row) < 3)
        raise MeshError(
            f"vertex {short} (line {lines.vertex_lines[short]}) has {len(rows[short])} coordinates, not 3",
            DAMAGED_HINT,
        )
    n_columns = 6 if n_columns >= 6 else 3
    try:
        values = np.array([row[:n_columns] for row in rows], dtype=np.float64)
    except ValueError:
        bad = next(i for i, row in enumerate(rows) if not all(map(_is_number, row[:n_columns])))
        raise MeshError(
            f"vertex {bad} (line {lines.vertex_lines[bad]}) is not made of numbers: '{lines.vertices[bad]}'",
            DAMAGED_HINT,
        ) from None
    return values[:, :3].copy(), rgba_from_values(values[:, 3:]) if n_columns == 6 else None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _parse_uv(rows: Sequence[str]) -> NDArray[np.float64]:
    """Texture coordinates; a third one (w) is dropped and a missing second one is 0."""
    return np.array([[*row.split()[:2], "0"][:2] for row in rows], dtype=np.float64)


def _parse_corners(
    lines: _Lines, triangulate: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Of all corners, vertex ids (C,) and texture coordinate ids (C,), from 0, −1 for none; and corners a face (F,)."""
    corners = [line.split() for line in lines.faces]
    for face_id, face in enumerate(corners):
        if len(face) != 3 and not (triangulate and len(face) > 3):
            raise polygon_error(face_id, len(face), f" (line {lines.face_lines[face_id]})")
    lengths = np.array([len(face) for face in corners], dtype=np.int64)
    ends = np.cumsum(lengths)
    words = [word for face in corners for word in face]
    try:
        if any("/" in line for line in lines.faces):
            pairs = [word.split("/", 2)[:2] for word in words]
            vertex = np.array([pair[0] for pair in pairs], dtype=np.int64)
            uv = np.array([pair[1] or 0 if len(pair) > 1 else 0 for pair in pairs], dtype=np.int64)
        else:
            vertex, uv = np.array(words, dtype=np.int64), np.zeros(len(words), dtype=np.int64)
    except (ValueError, OverflowError):
        bad = next(i for i, word in enumerate(words) if not _is_corner(word))
        face_id = int(np.searchsorted(ends, bad, side="right"))
        raise _face_error(lines, face_id, f"has a corner '{words[bad]}', which is no index") from None
    for face_id, n_vertices, n_uv in lines.relative:
        # A negative index counts back from the last line read so far; −1 is that line.
        own = slice(ends[face_id] - lengths[face_id], ends[face_id])
        vertex[own] = np.where(vertex[own] < 0, vertex[own] + n_vertices + 1, vertex[own])
        uv[own] = np.where(uv[own] < 0, uv[own] + n_uv + 1, uv[own])
    _check_range(lines, vertex, ends, 1, len(lines.vertices), "vertex")
    _check_range(lines, uv, ends, 0, len(lines.uv), "texture coordinate")
    return vertex - 1, uv - 1, lengths


def _is_corner(word: str) -> bool:
    parts = word.split("/", 2)[:2]
    return all(_is_index(part) or (i == 1 and not part) for i, part in enumerate(parts))


def _is_index(word: str) -> bool:
    try:
        np.array([word], dtype=np.int64)
    except (ValueError, OverflowError):
        return False
    return True


def _check_range(
    lines: _Lines, indices: NDArray[np.int64], ends: NDArray[np.int64], low: int, high: int, what: str
) -> None:
    outside = (indices < low) | (indices > high)
    if outside.any():
        corner = int(np.argmax(outside))
        face_id = int(np.searchsorted(ends, corner, side="right"))
        raise _face_error(
            lines, face_id, f"refers to {what} {int(indices[corner])} of {high} (counted from 1)"
        )


def _face_error(lines: _Lines, face_id: int, what: str) -> MeshError:
    return MeshError(f"face {face_id} (line {lines.face_lines[face_id]}) {what}", DAMAGED_HINT)
