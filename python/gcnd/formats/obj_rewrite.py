"""OBJ written again with moved vertices: groups, smoothing groups, materials, texture coordinates and comments stay."""

from __future__ import annotations

import numpy as np

from gcnd.formats.words import replaced_words, text_lines
from gcnd.meshes.normals import Motion

__all__ = ["rewrite_obj"]


def rewrite_obj(data: bytes, motion: Motion) -> bytes:
    """Writes an OBJ file again; each normal (vn) becomes that of the corners that use it.

    Args:
        data: The whole file.
        motion: Of the file's own vertices and faces.

    Returns:
        The whole file.
    """
    lines = _joined(text_lines(data))
    vertex_places, normal_places, corner_normals = [], [], []
    for place, line in enumerate(lines):
        words = line.replace("\\\r\n", " ").replace("\\\n", " ").partition("#")[0].split()
        match words[:1]:
            case ["v"]:
                vertex_places.append(place)
            case ["vn"]:
                normal_places.append(place)
            case ["f"]:
                corner_normals += [_normal_id(word, len(normal_places)) for word in words[1:]]
    for vertex_id, place in enumerate(vertex_places):
        if (motion.before[vertex_id] != motion.after[vertex_id]).any():
            lines[place] = replaced_words(lines[place], 1, motion.after[vertex_id])
    if normal_places:
        old = np.array(
            [lines[place].replace("\\", " ").split()[1:4] for place in normal_places], dtype=np.float64
        )
        users = motion.by_triangle(np.array(corner_normals, dtype=np.int64))
        users[users >= len(old)] = -1
        new = motion.shared_normals(old, users)
        for place, before, after in zip(normal_places, old, new, strict=True):
            if (before != after).any():
                lines[place] = replaced_words(lines[place], 1, np.round(after, 7))
    return "".join(lines).encode("utf-8", errors="surrogateescape")


def _joined(lines: list[str]) -> list[str]:
    """Joins every line that a backslash ends to the next, as they are."""
    joined: list[str] = []
    goes_on = False
    for line in lines:
        if goes_on:
            joined[-1] += line
        else:
            joined.append(line)
        goes_on = line.endswith(("\\\n", "\\\r\n"))
    return joined


def _normal_id(word: str, n_so_far: int) -> int:
    """Number of the normal of a face corner, from 0; −1 where it has none."""
    parts = word.split("/")
    if len(parts) < 3 or not parts[2]:
        return -1
    index = int(parts[2])
    return index + n_so_far if index < 0 else index - 1
