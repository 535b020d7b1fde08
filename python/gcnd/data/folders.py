"""Meshes in a folder, at any depth."""

from __future__ import annotations

from pathlib import Path

from gcnd.errors import ConfigError
from gcnd.mesh_io import SUPPORTED


def find_meshes(folder: Path) -> list[Path]:
    """Find every mesh file below a folder; hidden ones are left out.

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
    paths = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in SUPPORTED and not path.name.startswith(".") and path.is_file()
    ]
    if not paths:
        raise ConfigError(f"no mesh in {folder}", hint=f"supported: {', '.join(SUPPORTED)}")
    return paths
