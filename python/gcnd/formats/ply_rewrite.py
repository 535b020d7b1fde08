"""PLY written again with moved vertices: header, comments, other elements and properties stay byte for byte."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.formats.ply_header import PlyElement, parse_header
from gcnd.formats.ply_ragged import layout_binary, layout_text
from gcnd.formats.ply_real import with_real_positions
from gcnd.formats.ply_uniform import has_face_indices, uniform_numbers, uniform_rows
from gcnd.meshes.normals import Motion

__all__ = ["rewrite_ply"]

_POSITION, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")

Column = NDArray[Any]


def rewrite_ply(data: bytes, motion: Motion) -> bytes:
    """Writes a PLY file again with moved vertices, and with new normals of vertices and faces where it has them.

    Args:
        data: The whole file.
        motion: Of the file's own vertices and faces.

    Returns:
        The whole file; positions that were whole numbers have the type `float` or `double`, if any vertex moved.
    """
    data = with_real_positions(data, motion)
    header = parse_header(data)
    if header.byte_order is None:
        return _rewrite_text(data, header.elements, header.data_start, motion)
    changed = bytearray(data)
    start = header.data_start
    for element in header.elements:
        is_split = motion.polygons is not None and has_face_indices(element)
        found = None if is_split else uniform_rows(data, start, element, header.byte_order)
        if found is None:
            start = _rewrite_ragged(data, changed, start, element, header.byte_order, motion)
            continue
        rows = np.ndarray((element.count,), dtype=found.dtype, buffer=changed, offset=start)
        old = {name: rows[name] for name in rows.dtype.names or ()}
        for name, (is_new, column) in _new_columns(element, old, motion).items():
            rows[name][is_new] = column[is_new]
        start += rows.nbytes
    return bytes(changed)


def _rewrite_ragged(
    data: bytes, changed: bytearray, start: int, element: PlyElement, order: str, motion: Motion
) -> int:
    """Puts new values into records of any lengths; returns where they end."""
    layout = layout_binary(data, start, element, order)
    raw = np.frombuffer(changed, np.uint8)
    dtypes = {p.name: np.dtype(order + p.dtype) for p in element.properties if p.count_dtype is None}
    places = {
        name: layout.places[name][:, None] + np.arange(dtypes[name].itemsize)
        for name in (*_POSITION, *_NORMAL)
        if name in dtypes
    }
    old = {name: np.ascontiguousarray(raw[p]).view(dtypes[name]).reshape(-1) for name, p in places.items()}
    for name, (is_new, values) in _new_columns(element, old, motion).items():
        numbers = np.ascontiguousarray(values[is_new], dtype=dtypes[name])
        raw[places[name][is_new]] = numbers.view(np.uint8).reshape(len(numbers), numbers.itemsize)
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
        is_split = motion.polygons is not None and has_face_indices(element)
        table = None if is_split else uniform_numbers(numbers, first, element)
        if table is None:
            layout = layout_text(numbers, first, element)
            places, first = layout.places, layout.end
        else:
            rows, column_of = table
            starts = first + rows.shape[1] * np.arange(len(rows))
            places = {name: starts + column for name, column in column_of.items() if isinstance(column, int)}
            first += rows.size
        names = [p.name for p in element.properties if p.count_dtype is None]
        old = {name: numbers[places[name]] for name in names if name in (*_POSITION, *_NORMAL)}
        for name, (is_new, values) in _new_columns(element, old, motion).items():
            words = places[name][is_new].tolist()
            changes |= dict(zip(words, values[is_new].tolist(), strict=True))
    pieces, end = [data[:start]], 0
    for word in sorted(changes):
        a, b = spans[word]
        pieces += [data[start + end : start + a], repr(changes[word]).encode("ascii")]
        end = b
    return b"".join([*pieces, data[start + end :]])
