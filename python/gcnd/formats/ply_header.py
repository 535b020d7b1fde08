"""The header of a PLY file: its elements and their properties."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gcnd.errors import MeshError
from gcnd.formats.parsed import DAMAGED_HINT

__all__ = ["PlyElement", "PlyHeader", "PlyProperty", "parse_header"]

DTYPE_FROM_PLY = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float16": "f2",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
"""numpy's type for each name that PLY files use, without its byte order."""


@dataclass(frozen=True)
class PlyProperty:
    """One property of an element: a number, or a list of numbers when `count_dtype` is given."""

    name: str
    dtype: str
    count_dtype: str | None = None


@dataclass
class PlyElement:
    """One element of the file, such as "vertex" or "face", with its properties in file order."""

    name: str
    count: int
    properties: list[PlyProperty] = field(default_factory=list)


@dataclass
class PlyHeader:
    """All that the header says, and where the data begins.

    Attributes:
        byte_order: "<" or ">" for binary data, None for text.
        elements: The elements, in file order.
        texture: The image that a `comment TextureFile` names, or None.
        data_start: Offset of the first data byte.
    """

    byte_order: Literal["<", ">"] | None
    elements: list[PlyElement]
    texture: str | None
    data_start: int


# One line ending follows, and no more: the data itself may begin with a byte that looks like one.
_END = re.compile(rb"end_header(?:[ \t]*(?:\r\n|\n|\r))?")

_BYTE_ORDERS: dict[str, Literal["<", ">"] | None] = {
    "ascii": None,
    "binary_little_endian": "<",
    "binary_big_endian": ">",
}


def parse_header(data: bytes) -> PlyHeader:
    """Reads the header of a PLY file.

    Args:
        data: The whole file.

    Returns:
        The header.

    Raises:
        MeshError: If it is no PLY header, or one that does not end, with the offending line.
    """
    if not data.startswith(b"ply") or data[3:4] not in (b"\n", b"\r", b" ", b"\t"):
        raise MeshError(
            "it does not start with the word 'ply'", "check that the extension matches the content"
        )
    end_line = _END.search(data)
    if end_line is None:
        raise MeshError("its header has no end_header line", DAMAGED_HINT)
    header = PlyHeader(None, [], None, end_line.end())
    has_format = False
    for raw in data[: end_line.start()].splitlines()[1:]:
        line = raw.decode("utf-8", errors="replace")
        words = line.split()
        try:
            has_format |= _read_line(words, header, line)
        except (IndexError, KeyError, ValueError) as error:
            if isinstance(error, MeshError):
                raise
            raise MeshError(f"its header line '{line.strip()}' makes no sense", DAMAGED_HINT) from None
    if not has_format:
        raise MeshError("its header has no format line", DAMAGED_HINT)
    return header


def _read_line(words: list[str], header: PlyHeader, line: str) -> bool:
    """Takes one header line in; returns whether it was the format line."""
    match words[:1]:
        case ["format"]:
            header.byte_order = _BYTE_ORDERS[words[1]]
            return True
        case ["element"]:
            count = int(words[2])
            if count < 0:
                raise ValueError(words[2])
            header.elements.append(PlyElement(words[1], count))
        case ["property"] if words[1] == "list":
            count_type, value_type, name = words[2:5]
            count_dtype = DTYPE_FROM_PLY[count_type]
            if np.dtype(count_dtype).kind == "f":
                raise ValueError(count_type)
            _add(header.elements[-1], PlyProperty(name, DTYPE_FROM_PLY[value_type], count_dtype))
        case ["property"]:
            _add(header.elements[-1], PlyProperty(words[2], DTYPE_FROM_PLY[words[1]]))
        case ["comment"] if len(words) > 2 and words[1].lower() == "texturefile":
            start = line.lower().index("texturefile") + len("texturefile")
            header.texture = header.texture or line[start:].strip()
        case ["comment"] | ["obj_info"] | []:
            pass
        case _:
            raise ValueError(line)
    return False


def _add(element: PlyElement, own: PlyProperty) -> None:
    if any(other.name == own.name for other in element.properties):
        raise MeshError(
            f"its element '{element.name}' has two properties '{own.name}'",
            "nothing says which of the two is meant: rename one in the header",
        )
    element.properties.append(own)
