"""Files beside a mesh file that it refers to by name: ordinary ones, in its folder or below, of a bounded size."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath
from typing import Any

from gcnd.errors import MeshError

__all__ = ["find_beside", "resolver_beside"]

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
    if "\0" in name:
        return None
    home = folder.resolve()
    path = (home / PurePosixPath(name.strip().replace("\\", "/"))).resolve()
    # Of a name that is too long, os.path tells that it is not there, where Path.is_file fails.
    if not (path.is_relative_to(home) and os.path.isfile(path)):
        return None
    if path.stat().st_size > _LARGEST_FILE:
        raise MeshError(f"{path} has more than {_LARGEST_FILE:,} bytes", "a material or texture is smaller")
    return path


def resolver_beside(folder: Path) -> Any:
    """Makes what trimesh's readers ask for files that a mesh refers to."""
    import trimesh

    class FilesBeside(trimesh.resolvers.FilePathResolver):  # type: ignore[misc, unused-ignore]
        def get(self, name: str) -> bytes:
            # Others write full paths of their own machines: the file of that name beside the mesh is meant.
            last = name.strip().replace("\\", "/").rpartition("/")[-1]
            path = find_beside(folder, name) or find_beside(folder, last)
            if path is None:
                raise FileNotFoundError(name)
            return path.read_bytes()

    return FilesBeside(str(folder))
