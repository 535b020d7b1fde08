"""Records of a PLY element whose lists have as many values in one record as in the next: a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import DAMAGED_HINT, polygon_error, truncated_error
from gcnd.formats.ply_header import PlyElement, PlyProperty

__all__ = ["INDEX_NAMES", "has_face_indices", "uniform_numbers", "uniform_rows"]

INDEX_NAMES = ("vertex_indices", "vertex_index")

Column = NDArray[Any]


def has_face_indices(element: PlyElement) -> bool:
    """Returns whether an element holds the corners of faces."""
    return any(_is_face_indices(element, p) for p in element.properties)


def uniform_rows(data: bytes, position: int, element: PlyElement, order: str) -> Column | None:
    """Finds the records of an element in a binary file.

    Args:
        data: The whole file.
        position: Where the element begins.
        element: Its properties and count; the corners of a face are taken to be three.
        order: "<" or ">".

    Returns:
        The records, with a field for each property and "NAME length" before each list; None where the lists of one
        record are not as long as those of the next, or may not be.

    Raises:
        MeshError: If a face has other than three corners, or the data ends too soon.
    """
    lengths = _first_lengths_binary(data, position, element, order)
    record = np.dtype(_fields(element, lengths, order))
    n_whole = min(element.count, max(0, len(data) - position) // max(record.itemsize, 1))
    rows = np.frombuffer(data, dtype=record, count=n_whole, offset=min(position, len(data)))
    counts = {name: rows[f"{name} length"] for name in lengths}
    return rows if _is_table(element, lengths, counts, n_whole) else None


def uniform_numbers(
    numbers: NDArray[np.float64], position: int, element: PlyElement
) -> tuple[NDArray[np.float64], dict[str, int | slice]] | None:
    """Finds the records of an element among the numbers of a text file; errors as of `uniform_rows`.

    Args:
        numbers: Of the whole data.
        position: Where the element begins among them.
        element: Its properties and count; the corners of a face are taken to be three.

    Returns:
        The records (n, k), and the column of each property, of a list a slice; None as of `uniform_rows`.
    """
    lengths = _first_lengths_text(numbers[position:], element)
    column_of: dict[str, int | slice] = {}
    count_column: dict[str, int] = {}
    width = 0
    for p in element.properties:
        if p.count_dtype:
            count_column[p.name] = width
            column_of[p.name] = slice(width + 1, width + 1 + lengths[p.name])
            width += 1 + lengths[p.name]
        else:
            column_of[p.name] = width
            width += 1
    n_whole = min(element.count, (len(numbers) - position) // max(width, 1))
    rows = numbers[position : position + n_whole * width].reshape(n_whole, width)
    counts = {name: rows[:, column] for name, column in count_column.items()}
    return (rows, column_of) if _is_table(element, lengths, counts, n_whole) else None


def _is_table(
    element: PlyElement, lengths: Mapping[str, int], counts: Mapping[str, Column], n_whole: int
) -> bool:
    """Whether all records are there, with lists as long as the first record's.

    All records before the first other one were read at their true place, so its number is right; records after it are
    not.
    """
    first_bad: tuple[int, PlyProperty] | None = None
    for p in element.properties:
        if p.count_dtype is None:
            continue
        wrong = np.flatnonzero(counts[p.name] != lengths[p.name])
        if len(wrong) and (first_bad is None or wrong[0] < first_bad[0]):
            first_bad = (int(wrong[0]), p)
    if first_bad is not None:
        record, prop = first_bad
        if _is_face_indices(element, prop):
            raise polygon_error(record, int(counts[prop.name][record]))
        return False
    if n_whole == element.count:
        return True
    if any(p.count_dtype and not _is_face_indices(element, p) for p in element.properties):
        return False  # the last lists may be shorter than the first
    raise truncated_error(f"{element.name} records", element.count, n_whole)


def _is_face_indices(element: PlyElement, prop: PlyProperty) -> bool:
    return element.name == "face" and prop.count_dtype is not None and prop.name in INDEX_NAMES


def _first_lengths_binary(data: bytes, position: int, element: PlyElement, order: str) -> dict[str, int]:
    """Length of each list in the element's first record; a face's indices are taken to be three."""
    lengths: dict[str, int] = {}
    for p in element.properties:
        if p.count_dtype:
            count_dtype = np.dtype(order + p.count_dtype)
            is_inside = element.count > 0 and position + count_dtype.itemsize <= len(data)
            first = int(np.frombuffer(data, count_dtype, 1, position)[0]) if is_inside else 0
            lengths[p.name] = 3 if _is_face_indices(element, p) else _plausible(first, element, p)
            position += count_dtype.itemsize + lengths[p.name] * np.dtype(p.dtype).itemsize
        else:
            position += np.dtype(p.dtype).itemsize
    return lengths


def _first_lengths_text(numbers: NDArray[np.float64], element: PlyElement) -> dict[str, int]:
    """Length of each list in the element's first record; a face's indices are taken to be three."""
    lengths: dict[str, int] = {}
    column = 0
    for p in element.properties:
        if p.count_dtype:
            is_inside = element.count > 0 and column < len(numbers) and np.isfinite(numbers[column])
            first = int(numbers[column]) if is_inside else 0
            lengths[p.name] = 3 if _is_face_indices(element, p) else _plausible(first, element, p)
            column += lengths[p.name]
        column += 1
    return lengths


def _plausible(length: int, element: PlyElement, prop: PlyProperty) -> int:
    if not 0 <= length <= 4096:
        raise MeshError(f"list '{prop.name}' of {element.name} 0 has length {length}", DAMAGED_HINT)
    return length


def _fields(element: PlyElement, lengths: Mapping[str, int], order: str) -> list[Any]:
    """numpy's fields of an element's records in a file: its properties, and "NAME length" before a list."""
    fields: list[Any] = []
    for p in element.properties:
        if p.count_dtype:
            fields.append((f"{p.name} length", order + p.count_dtype))
            fields.append((p.name, order + p.dtype, (lengths[p.name],)))
        else:
            fields.append((p.name, order + p.dtype))
    return fields
