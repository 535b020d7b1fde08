"""Records of a PLY element whose lists differ in length, as faces of three and four corners do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import (
    DAMAGED_HINT,
    ParsedMesh,
    check_ids,
    polygon_error,
    triangles_of,
    truncated_error,
)
from gcnd.formats.ply_header import PlyElement

__all__ = ["RaggedLayout", "keep_even_lists", "layout_binary", "layout_text", "read_ragged", "take_polygons"]

_LONGEST = 4096
"""Of a list: what is longer is taken for damage, as elsewhere in PLY files."""


@dataclass
class RaggedLayout:
    """Says where the values of an element are.

    Attributes:
        places: By property, where its value or the first value of its list begins in each record (n,): bytes in
            binary files, words in text.
        lengths: By list property, values in each record (n,).
        end: Where the element ends.
    """

    places: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    lengths: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    end: int = 0

    def all_places(self, name: str, size: int) -> NDArray[np.int64]:
        """Returns where every value of a property is, those of all lists one after the other, ``size`` apart."""
        if name not in self.lengths:
            return self.places[name]
        lengths = self.lengths[name]
        within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        places: NDArray[np.int64] = np.repeat(self.places[name], lengths) + size * within
        return places

    def with_lengths(self, values: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Returns values by property, and for each list property its lengths as "NAME length"."""
        return values | {f"{name} length": lengths for name, lengths in self.lengths.items()}


def layout_binary(data: bytes, start: int, element: PlyElement, order: str) -> RaggedLayout:
    """Finds the values of an element in a binary file.

    Args:
        data: The whole file.
        start: Where the element begins.
        element: Its properties and count.
        order: "<" or ">".

    Returns:
        The layout, in bytes.

    Raises:
        MeshError: If the data ends too soon, or a list is implausibly long.
    """

    def length_at(place: int, dtype: str) -> int:
        return int(np.frombuffer(data, order + dtype, 1, place)[0])

    sizes = {p.name: np.dtype(p.dtype).itemsize for p in element.properties}
    count_sizes = {
        p.name: np.dtype(p.count_dtype).itemsize if p.count_dtype else 0 for p in element.properties
    }
    return _layout(start, len(data), element, length_at, sizes, count_sizes)


def read_ragged(
    data: bytes, start: int, element: PlyElement, order: str
) -> tuple[dict[str, NDArray[Any]], int]:
    """Reads an element of a binary file; arguments and errors as of `layout_binary`.

    Returns:
        Values by property, of a list those of all records one after the other, and "NAME length" (n,) for each list;
        and where the element ends.
    """
    layout = layout_binary(data, start, element, order)
    raw = np.frombuffer(data, np.uint8)
    values: dict[str, NDArray[Any]] = {}
    for p in element.properties:
        size = np.dtype(p.dtype).itemsize
        places = layout.all_places(p.name, size)[:, None] + np.arange(size)
        found = np.ascontiguousarray(raw[places]).view(order + p.dtype).reshape(-1)
        values[p.name] = found.astype(found.dtype.newbyteorder("="))
    return layout.with_lengths(values), layout.end


def layout_text(numbers: NDArray[np.float64], start: int, element: PlyElement) -> RaggedLayout:
    """Finds the values of an element among the numbers of a text file; see `layout_binary`."""
    ones = {p.name: 1 for p in element.properties}
    return _layout(start, len(numbers), element, lambda place, _: float(numbers[place]), ones, ones)


def _layout(
    start: int,
    end: int,
    element: PlyElement,
    length_at: Callable[[int, str], float],
    sizes: dict[str, int],
    count_sizes: dict[str, int],
) -> RaggedLayout:
    places: dict[str, list[int]] = {p.name: [] for p in element.properties}
    lengths: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count_dtype}
    place = start
    for record in range(element.count):
        for p in element.properties:
            length = 1
            if p.count_dtype:
                if place + count_sizes[p.name] > end:
                    raise truncated_error(f"{element.name} records", element.count, record)
                found = length_at(place, p.count_dtype)
                if not 0 <= found <= _LONGEST or found != int(found):
                    raise MeshError(
                        f"list '{p.name}' of {element.name} {record} has length {found:g}", DAMAGED_HINT
                    )
                length = int(found)
                lengths[p.name].append(length)
                place += count_sizes[p.name]
            places[p.name].append(place)
            place += length * sizes[p.name]
        if place > end:
            raise truncated_error(f"{element.name} records", element.count, record)
    return RaggedLayout(
        {name: np.array(values, dtype=np.int64) for name, values in places.items()},
        {name: np.array(values, dtype=np.int64) for name, values in lengths.items()},
        place,
    )


def take_polygons(
    parsed: ParsedMesh, ids: NDArray[np.int64], lengths: NDArray[np.int64], face: dict[str, NDArray[Any]]
) -> None:
    """Splits faces given corner by corner, and gives each triangle the values of its face.

    Args:
        parsed: Has its vertices; gets its faces.
        ids: Vertex of every corner (C,).
        lengths: Corners of each face (F,).
        face: The other values by face, as `read_ragged` has them; by triangle afterwards. A list that is as long as no
            other, and no texture coordinate a corner, is left out.

    Raises:
        MeshError: A face has fewer than three corners, or refers to a vertex that does not exist.
    """
    if (lengths < 3).any():
        bad = int(np.argmax(lengths < 3))
        raise polygon_error(bad, int(lengths[bad]))
    check_ids(ids, lengths, len(parsed.vertices))
    corners, parsed.polygons = triangles_of(parsed.vertices, ids, lengths)
    parsed.faces = ids[corners]
    owner = np.arange(len(lengths)) if parsed.polygons is None else parsed.polygons.owner
    uv_lengths = face.get("texcoord length")
    if uv_lengths is not None and np.array_equal(uv_lengths, 2 * lengths):
        del face["texcoord length"]
        by_corner = face["texcoord"].reshape(-1, 2)[corners].reshape(-1, 6)
    else:
        by_corner = None
    keep_even_lists(face)
    for name in face:
        face[name] = by_corner if name == "texcoord" and by_corner is not None else face[name][owner]


def keep_even_lists(columns: dict[str, NDArray[Any]]) -> None:
    """Makes each list of values that `read_ragged` has read a table (n, k), in place; others fall away.

    Args:
        columns: Values by property, with "NAME length" (n,) of lists; afterwards without these, and without lists of
            which not all are as long.
    """
    for name in [name for name in columns if not name.endswith(" length")]:
        lengths = columns.pop(f"{name} length", None)
        if lengths is None:
            continue
        if len(lengths) and (lengths == lengths[0]).all():
            columns[name] = columns[name].reshape(len(lengths), -1)
        else:
            del columns[name]
