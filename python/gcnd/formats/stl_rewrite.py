"""STL written again with moved vertices: header, names of solids and spare bytes stay."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from gcnd.formats.stl import HEADER_BYTES, RECORD, binary_faces
from gcnd.formats.words import replaced_words
from gcnd.meshes.normals import Motion

__all__ = ["rewrite_stl"]

_NUMBERS = re.compile(rb"(?:facet\s+normal|vertex)\s+\S+\s+\S+\s+\S+", re.IGNORECASE)


def rewrite_stl(data: bytes, motion: Motion) -> bytes:
    """Writes an STL file again; normals that are not zero are made anew.

    Args:
        data: The whole file.
        motion: From the positions that `read_stl` returns.

    Returns:
        The whole file, text or binary as it was.
    """
    n_faces = len(motion.faces)
    corners = motion.after[motion.faces]
    if binary_faces(data) is not None:
        changed = bytearray(data)
        rows = np.ndarray((n_faces,), dtype=RECORD, buffer=changed, offset=HEADER_BYTES)
        moved = motion.has_moved
        rows["normal"][moved] = _new_normals(motion, rows["normal"].astype(np.float64))[moved]
        rows["corners"][moved] = corners[moved]
        return bytes(changed)
    found = list(_NUMBERS.finditer(data))
    # Latin-1 has a letter for every byte: what else stands in the lines survives.
    texts = [match.group().decode("latin-1") for match in found]
    normals = np.array([text.split()[2:] for text in texts[::4]], dtype=np.float64)
    new_normals = _new_normals(motion, normals)
    pieces, end = [], 0
    for index, (match, text) in enumerate(zip(found, texts, strict=True)):
        face_id, place = divmod(index, 4)
        if place and (motion.before[3 * face_id + place - 1] != corners[face_id, place - 1]).any():
            text = replaced_words(text, 1, corners[face_id, place - 1])
        elif not place and (new_normals[face_id] != normals[face_id]).any():
            text = replaced_words(text, 2, new_normals[face_id])
        pieces += [data[end : match.start()], text.encode("latin-1")]
        end = match.end()
    return b"".join([*pieces, data[end:]])


def _new_normals(motion: Motion, old: NDArray[np.float64]) -> NDArray[np.float64]:
    new: NDArray[np.float64] = np.where(
        (old != 0.0).any(axis=1, keepdims=True), motion.face_normals(old), old
    )
    return new
