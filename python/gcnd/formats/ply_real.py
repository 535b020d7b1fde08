"""PLY files whose positions are whole numbers, made ready for moved ones: their types change, and all else stays."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from gcnd.formats.export import needs_float64
from gcnd.formats.ply_header import PlyHeader, parse_header
from gcnd.formats.ply_ragged import layout_binary
from gcnd.formats.ply_uniform import has_face_indices, uniform_rows
from gcnd.meshes.normals import Motion

__all__ = ["with_real_positions"]

_POSITION = ("x", "y", "z")
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\n|\r)?")
_ELEMENT = re.compile(rb"\s*element\s+(\S+)")
_PROPERTY = re.compile(rb"(\s*property\s+)(\S+)(\s+([xyz])\s*)")


def with_real_positions(data: bytes, motion: Motion) -> bytes:
    """Gives positions that are whole numbers the type `float`, or `double` where 32 bits would move a vertex.

    Args:
        data: The whole file, which its reader has found to be right.
        motion: Of the file's own vertices and faces, for the choice of the type.

    Returns:
        The whole file with the same numbers; the same bytes where no position is of a whole type, or none changes.
    """
    header = parse_header(data)
    whole = {
        p.name: p.dtype
        for e in header.elements
        if e.name == "vertex"
        for p in e.properties
        if p.name in _POSITION and p.count_dtype is None and np.dtype(p.dtype).kind != "f"
    }
    if not whole or np.array_equal(motion.before, motion.after):
        return data
    numbers = motion.before[:, [_POSITION.index(name) for name in whole]]
    is_wide = not np.array_equal(numbers, numbers.astype(np.float32)) or needs_float64(
        motion.after, motion.faces
    )
    pieces = [_with_types(data[: header.data_start], set(whole), b"double" if is_wide else b"float")]
    end = header.data_start
    if header.byte_order is not None:
        kind = np.dtype(header.byte_order + ("f8" if is_wide else "f4"))
        for place, old in _places(data, header, whole, is_split=motion.polygons is not None):
            number = np.frombuffer(data, old, 1, place).astype(kind)
            pieces += [data[end:place], number.tobytes()]
            end = place + old.itemsize
    return b"".join([*pieces, data[end:]])


def _with_types(head: bytes, names: set[str], type_name: bytes) -> bytes:
    """The header with another type for these properties of the vertices."""
    lines = _LINE.findall(head)
    element = b""
    for i, line in enumerate(lines):
        named = _ELEMENT.match(line)
        element = named[1] if named else element
        found = _PROPERTY.fullmatch(line)
        if found and element == b"vertex" and found[4].decode("ascii") in names:
            lines[i] = found[1] + type_name + found[3]
    return b"".join(lines)


def _places(
    data: bytes, header: PlyHeader, whole: dict[str, str], *, is_split: bool
) -> Iterator[tuple[int, np.dtype[Any]]]:
    """Where a binary file has these properties of the vertices, in its order, and their types there."""
    order = header.byte_order or "<"
    start = header.data_start
    for element in header.elements:
        rows = None if is_split and has_face_indices(element) else uniform_rows(data, start, element, order)
        if rows is None:
            layout = layout_binary(data, start, element, order)
            places, end = layout.places, layout.end
        else:
            firsts = start + rows.itemsize * np.arange(len(rows))
            places = {name: firsts + offset for name, (_, offset, *_) in (rows.dtype.fields or {}).items()}
            end = start + rows.nbytes
        if element.name == "vertex":
            dtypes = [np.dtype(order + dtype) for dtype in whole.values()]
            for row in np.column_stack([places[name] for name in whole]).tolist():
                yield from zip(row, dtypes, strict=True)
        start = end
