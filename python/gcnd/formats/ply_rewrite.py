"""PLY written again with moved vertices: header, comments, other elements and properties stay byte for byte."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.formats.ply import first_lengths_binary, first_lengths_text, has_face_indices, record_fields
from gcnd.formats.ply_header import PlyElement, parse_header
from gcnd.formats.ply_ragged import layout_binary, layout_text
from gcnd.meshes.normals import Motion

__all__ = ["rewrite_ply"]

_POSITION, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")

Column = NDArray[Any]


def rewrite_ply(data: bytes, motion: Motion) -> bytes | None:
    """Writes a PLY file again with moved vertices, and with new normals of vertices and faces where it has them.

    Args:
        data: The whole file.
        motion: Of the file's own vertices and faces.

    Returns:
        The whole file, or None where it keeps positions as whole numbers.
    """
    header = parse_header(data)
    columns = [p for e in header.elements if e.name == "vertex" for p in e.properties]
    if any(p.dtype[0] != "f" for p in columns if p.name in _POSITION):
        return None
    if header.byte_order is None:
        return _rewrite_text(data, header.elements, header.data_start, motion)
    changed = bytearray(data)
    start = header.data_start
    for element in header.elements:
        if motion.polygons is not None and has_face_indices(element):
            start = _rewrite_polygons(changed, start, element, header.byte_order, motion)
            continue
        lengths = first_lengths_binary(data, start, element, header.byte_order)
        record = np.dtype(record_fields(element, lengths, header.byte_order))
        rows = np.ndarray((element.count,), dtype=record, buffer=changed, offset=start)
        old = {name: rows[name] for name in rows.dtype.names or ()}
        for name, (is_new, column) in _new_columns(element, old, motion).items():
            rows[name][is_new] = column[is_new]
        start += rows.nbytes
    return bytes(changed)


def _rewrite_polygons(changed: bytearray, start: int, element: PlyElement, order: str, motion: Motion) -> int:
    """Puts new normals into faces of any number of corners; returns where they end."""
    layout = layout_binary(bytes(changed), start, element, order)
    dtypes = {p.name: np.dtype(order + p.dtype) for p in element.properties if p.count_dtype is None}
    old = {
        name: np.array([np.frombuffer(changed, dtype, 1, place)[0] for place in layout.places[name].tolist()])
        for name, dtype in dtypes.items()
        if name in _NORMAL
    }
    for name, (is_new, values) in _new_columns(element, old, motion).items():
        for row in np.flatnonzero(is_new).tolist():
            # An array: a number alone would forget its byte order.
            place, number = int(layout.places[name][row]), np.array([values[row]], dtype=dtypes[name])
            changed[place : place + number.itemsize] = number.tobytes()
    return layout.end


def _new_columns(
    element: PlyElement, old: dict[str, Column], motion: Motion
) -> dict[str, tuple[NDArray[np.bool_], Column]]:
    """What changes in an element: by name, which rows, and all rows' values."""
    new: dict[str, tuple[NDArray[np.bool_], Column]] = {}
    if element.name == "vertex":
        has_moved = (motion.before != motion.after).any(axis=1)
        new |= {name: (has_moved, motion.after[:, axis]) for axis, name in enumerate(_POSITION)}
    if element.name not in ("vertex", "face") or not all(
        name in old and old[name].dtype.kind == "f" for name in _NORMAL
    ):
        return new
    normals = np.column_stack([old[name] for name in _NORMAL]).astype(np.float64)
    renewed = motion.face_normals(normals) if element.name == "face" else motion.vertex_normals(normals)
    is_new = (renewed != normals).any(axis=1)
    return new | {name: (is_new, renewed[:, axis]) for axis, name in enumerate(_NORMAL)}


def _rewrite_text(data: bytes, elements: list[PlyElement], start: int, motion: Motion) -> bytes:
    spans = [match.span() for match in re.finditer(rb"\S+", data[start:])]
    numbers = np.array([float(data[start + a : start + b]) for a, b in spans])
    changes: dict[int, float] = {}
    first = 0
    for element in elements:
        if motion.polygons is not None and has_face_indices(element):
            layout = layout_text(numbers, first, element)
            names = [p.name for p in element.properties if p.count_dtype is None and p.name in _NORMAL]
            own = {name: numbers[layout.places[name]] for name in names}
            for name, (is_new, values) in _new_columns(element, own, motion).items():
                for row in np.flatnonzero(is_new).tolist():
                    changes[int(layout.places[name][row])] = float(values[row])
            first = layout.end
            continue
        lengths = first_lengths_text(numbers[first:], element)
        width = sum(1 + lengths.get(p.name, 0) for p in element.properties)
        rows = numbers[first : first + element.count * width].reshape(element.count, width)
        column_of: dict[str, int] = {}
        column = 0
        for p in element.properties:
            column_of[p.name] = column
            column += 1 + lengths.get(p.name, 0)
        old = {name: rows[:, index] for name, index in column_of.items()}
        for name, (is_new, values) in _new_columns(element, old, motion).items():
            for row in np.flatnonzero(is_new).tolist():
                changes[first + row * width + column_of[name]] = float(values[row])
        first += element.count * width
    pieces, end = [data[:start]], 0
    for word in sorted(changes):
        a, b = spans[word]
        pieces += [data[start + end : start + a], repr(changes[word]).encode("ascii")]
        end = b
    return b"".join([*pieces, data[start + end :]])
