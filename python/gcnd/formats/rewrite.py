"""A file written again with moved vertices: its positions and normals change, and every other byte stays.

Normals are those of the file, made anew around moved vertices; see `gcnd.meshes.normals.Motion`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

from gcnd.formats.glb_scene import rewrite_glb
from gcnd.formats.obj_rewrite import rewrite_obj
from gcnd.formats.off_rewrite import rewrite_off
from gcnd.formats.ply_rewrite import rewrite_ply
from gcnd.formats.stl_rewrite import rewrite_stl
from gcnd.meshes.normals import Motion

__all__ = ["BYTE_ORDER_MARK", "rewrite"]

BYTE_ORDER_MARK = b"\xef\xbb\xbf"

Rewriter: TypeAlias = Callable[[bytes, Motion], bytes]

_REWRITERS: Mapping[str, Rewriter] = {
    ".ply": rewrite_ply,
    ".obj": rewrite_obj,
    ".stl": rewrite_stl,
    ".off": rewrite_off,
    ".glb": rewrite_glb,
}


def rewrite(data: bytes, extension: str, motion: Motion) -> bytes:
    """Writes a file again with moved vertices.

    Args:
        data: The whole file, which its reader has found to be right.
        extension: Its extension, in lower case.
        motion: Of the file's own vertices and faces, without the copies that its reader makes at seams.

    Returns:
        The whole file.
    """
    mark = BYTE_ORDER_MARK if data.startswith(BYTE_ORDER_MARK) else b""
    return mark + _REWRITERS[extension](data[len(mark) :], motion)
