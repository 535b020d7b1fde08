"""OFF written again with moved vertices: comments, colours, texture coordinates and spaces stay."""

from __future__ import annotations

import numpy as np

from gcnd.formats.off import KEYWORD
from gcnd.formats.words import replaced_words, text_lines
from gcnd.meshes.normals import Motion

__all__ = ["rewrite_off"]


def rewrite_off(data: bytes, motion: Motion) -> bytes:
    """Writes a text OFF file again, with new normals where it has them.

    Args:
        data: The whole file.
        motion: From the positions that `read_off` returns.

    Returns:
        The whole file.
    """
    lines = text_lines(data)
    contents = [line.partition("#")[0].strip() for line in lines]
    places = [place for place, content in enumerate(contents) if content]
    keyword, _, rest = contents[places[0]].partition(" ")
    first = 1 if rest.strip() else 2
    places = places[first : first + len(motion.before)]
    new_normals = old_normals = np.zeros((len(places), 3))
    kind = KEYWORD.match(keyword)
    has_normals = kind is not None and bool(kind[3])
    if has_normals:
        old_normals = np.array([contents[place].split()[3:6] for place in places], dtype=np.float64)
        new_normals = motion.vertex_normals(old_normals)
    for vertex_id, place in enumerate(places):
        if (motion.before[vertex_id] != motion.after[vertex_id]).any():
            lines[place] = replaced_words(lines[place], 0, motion.after[vertex_id])
        if (old_normals[vertex_id] != new_normals[vertex_id]).any():
            lines[place] = replaced_words(lines[place], 3, new_normals[vertex_id])
    return "".join(lines).encode("utf-8", errors="surrogateescape")
