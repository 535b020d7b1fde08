"""Meshes in a folder, at any depth."""

from __future__ import annotations

import os
from pathlib import Path

from gcnd.errors import ConfigError
from gcnd.mesh_io import SUPPORTED


def find_meshes(folder: Path) -> list[Path]:
    """Find every mesh file below a folder, as `mesh_files`, of which there must be one.

    Args:
        folder: Where to look, at any depth.

    Returns:
        Paths, ordered by name.

    Raises:
        ConfigError: There is none.

    Example:
        >>> find_meshes(Path("meshes"))[0].name  # doctest: +SKIP
        'armadillo.ply'
    """
    paths = mesh_files(folder)
    if not paths:
        raise ConfigError(f"no mesh in {folder}", hint=f"supported: {', '.join(SUPPORTED)}")
    return paths


def mesh_files(folder: Path, without: Path | None = None) -> list[Path]:
    """Lists the mesh files below a folder, sorted; hidden ones, and those below ``without``, are left out."""
    found = []
    results = None if without is None else real_path(without)
    if results is not None and real_path(folder).is_relative_to(results):
        results = None  # the results go above: that leaves nothing out
    for path in sorted(folder.rglob("*")):
        is_hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if is_hidden or path.suffix.lower() not in SUPPORTED or not path.is_file():
            continue
        if results is None or not real_path(path).is_relative_to(results):
            found.append(path)
    return found


def real_path(path: Path) -> Path:
    """Follows links as far as they lead; `Path.resolve` fails at those that lead to themselves."""
    return Path(os.path.realpath(path))
