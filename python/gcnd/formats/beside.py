"""Files beside a mesh file that it refers to by name: ordinary ones, in its folder or below, of a bounded size."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import Any

from gcnd.errors import MeshError

__all__ = ["can_be_name", "find_beside", "libraries_of_line", "resolver_beside"]

_LARGEST_FILE = 1 << 30
"""Bytes of a material or texture."""


def find_beside(folder: Path, name: str) -> Path | None:
    """Finds a file that a mesh in ``folder`` refers to.

    Args:
        folder: Where the mesh file is.
        name: The reference, with forward or backward slashes.

    Returns:
        The file's real path; None if it is not there, is no ordinary file, or lies elsewhere, through a link or ``..``.

    Raises:
        MeshError: It has more than 2³⁰ bytes.
    """
    path = _path_beside(folder, name)
    if path is not None and path.stat().st_size > _LARGEST_FILE:
        raise MeshError(f"{path} has more than {_LARGEST_FILE:,} bytes", "a material or texture is smaller")
    return path


def can_be_name(name: str) -> bool:
    """Whether a file may have such a name: there is no NUL in it, and no lone surrogate, which JSON can hold."""
    try:
        return b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:
        return False


def _path_beside(folder: Path, name: str) -> Path | None:
    if not can_be_name(name):
        return None
    # Of a name that is too long, or a link that leads to itself, os.path tells that it is not there, where Path fails.
    home = Path(os.path.realpath(folder))
    path = Path(os.path.realpath(home / PurePosixPath(name.strip().replace("\\", "/"))))
    return path if path.is_relative_to(home) and os.path.isfile(path) else None


def libraries_of_line(folder: Path, line: str) -> list[str]:
    """Tells the material libraries of an OBJ's line apart, whose names may have spaces and have spaces between them.

    Args:
        folder: Where the OBJ file is.
        line: What follows ``mtllib``.

    Returns:
        The whole line where there is such a file; else what ends in ``.mtl``, else the words, where one of them is
        there; else the whole line.
    """
    for names in ([line], re.split(r"(?<=\.mtl)\s+", line, flags=re.IGNORECASE), line.split()):
        if any(_path_beside(folder, name) or _path_beside(folder, _last(name)) for name in names):
            return names
    return [line]


def _last(name: str) -> str:
    """A file's name without its folders. Others write full paths of their own machines: that file beside is meant."""
    return name.strip().replace("\\", "/").rpartition("/")[-1]


def resolver_beside(folder: Path) -> Any:
    """Makes what trimesh's readers ask for files that a mesh refers to."""
    import trimesh

    class FilesBeside(trimesh.resolvers.FilePathResolver):  # type: ignore[misc, unused-ignore]
        def get(self, name: str) -> bytes:
            path = find_beside(folder, name) or find_beside(folder, _last(name))
            if path is None:
                raise FileNotFoundError(name)
            return path.read_bytes()

    return FilesBeside(str(folder))
