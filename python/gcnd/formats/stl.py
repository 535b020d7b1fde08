"""STL, binary and text, reading and writing. The format holds three positions per face and no indices."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import DAMAGED_HINT, ParsedMesh, polygon_error, truncated_error
from gcnd.start import near_1

__all__ = ["HEADER_BYTES", "RECORD", "binary_faces", "read_stl", "write_stl"]

RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER_BYTES = 84
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(data: bytes) -> ParsedMesh:
    """Reads an STL file: face i has vertices 3i, 3i + 1 and 3i + 2, in the file's order.

    Corners at one position are not merged here, so that vertex 3i + k stays corner k of face i. Several
    solids in one file are taken together.

    Args:
        data: The whole file.

    Returns:
        The mesh; `face_attributes["stl"]` holds the two spare bytes of binary faces when any is set. A few bytes more,
        less than a face has, are its `oddity`.

    Raises:
        MeshError: If the file is no STL file, is cut off, or has a face that is not a triangle.
    """
    n_faces = binary_faces(data)
    if n_faces is None:
        return _read_text(data)
    if len(data) < HEADER_BYTES:
        raise MeshError(f"{len(data)} bytes are too short for an STL file", DAMAGED_HINT)
    n_expected, n_bytes = n_faces * RECORD.itemsize, len(data) - HEADER_BYTES
    if n_bytes < n_expected:
        raise truncated_error("bytes of faces", n_expected, n_bytes)
    n_more = n_bytes - n_expected
    if n_more >= RECORD.itemsize:
        raise MeshError(f"{n_more} bytes follow the {n_faces} faces it announces", DAMAGED_HINT)
    parsed = _read_binary(data, n_faces)
    if n_more:
        # Too few for a face that the count has left out: what some programs add.
        parsed.oddity = f"{n_more} bytes behind its {n_faces} faces belong to none"
    return parsed


def binary_faces(data: bytes) -> int | None:
    """Tells how many faces a binary STL file announces.

    Args:
        data: The whole file.

    Returns:
        The number, 0 for a file that is too short to say; None for a text.
    """
    n_faces = int.from_bytes(data[80:84], "little") if len(data) >= HEADER_BYTES else 0
    # Many binary files begin with the word "solid" as well; only the length tells.
    if len(data) == HEADER_BYTES + n_faces * RECORD.itemsize:
        return n_faces
    is_text = data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096].lower()
    return None if is_text else n_faces


def _soup(corners: NDArray[np.float64]) -> ParsedMesh:
    return ParsedMesh(corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3))


def _read_binary(data: bytes, n_faces: int) -> ParsedMesh:
    rows = np.frombuffer(data, dtype=RECORD, count=n_faces, offset=HEADER_BYTES)
    parsed = _soup(rows["corners"].reshape(-1, 3).astype(np.float64))
    if rows["attribute"].any():
        parsed.face_attributes["stl"] = rows["attribute"].astype(np.uint16)
    return parsed


def _read_text(data: bytes) -> ParsedMesh:
    lower = data.lower()
    n_facets = len(re.findall(rb"facet\s+normal", lower))
    n_closed = lower.count(b"endloop")
    if n_closed < n_facets or not lower.rstrip().rpartition(b"\n")[2].strip().startswith(b"endsolid"):
        raise (
            truncated_error("faces", n_facets, n_closed)
            if n_closed < n_facets
            else MeshError("it does not end with endsolid", DAMAGED_HINT)
        )
    found = _VERTEX.findall(data)
    if len(found) != 3 * n_facets:
        counts = [len(_VERTEX.findall(loop)) for loop in lower.split(b"endloop")[:n_facets]]
        face_id = next((i for i, count in enumerate(counts) if count != 3), 0)
        raise polygon_error(face_id, counts[face_id] if counts else 0)
    try:
        return _soup(np.array(found, dtype=np.float64).reshape(-1, 3))
    except ValueError:
        raise MeshError("a vertex is not made of numbers", DAMAGED_HINT) from None


def write_stl(mesh: ParsedMesh, *, as_text: bool) -> bytes:
    """Writes an STL file: binary, with 32 bits per coordinate, or text, whose numbers read back exactly.

    Args:
        mesh: The mesh; only its shape and `face_attributes["stl"]` (binary) are written.
        as_text: Whether to write text.

    Returns:
        The whole file.
    """
    corners = mesh.vertices[mesh.faces]
    near = near_1(mesh.vertices, mesh.faces)[0][mesh.faces]
    normals = np.cross(near[:, 1] - near[:, 0], near[:, 2] - near[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    if as_text:
        return _write_text(corners, normals)
    rows = np.zeros(len(corners), dtype=RECORD)
    rows["normal"], rows["corners"] = normals, corners
    spare = mesh.face_attributes.get("stl")
    if spare is not None and np.shape(spare) == (len(rows),) and spare.dtype == np.uint16:
        rows["attribute"] = spare
    # The header must not begin with "solid", which marks text.
    return b"binary STL".ljust(80, b"\0") + len(rows).to_bytes(4, "little") + rows.tobytes()


def _write_text(corners: NDArray[np.float64], normals: NDArray[np.float64]) -> bytes:
    lines = ["solid mesh"]
    for normal, face in zip(normals.tolist(), corners.tolist(), strict=True):
        lines += ["facet normal " + " ".join(map(repr, normal)), "outer loop"]
        lines += ["vertex " + " ".join(map(repr, corner)) for corner in face]
        lines += ["endloop", "endfacet"]
    lines.append("endsolid mesh\n")
    return "\n".join(lines).encode("ascii")
