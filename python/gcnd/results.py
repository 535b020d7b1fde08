"""A mesh file whose result is to be written: what the result's file can hold is checked before the work."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd.errors import ConfigError
from gcnd.formats.referred import check_copies
from gcnd.mesh_io import load, save

if TYPE_CHECKING:
    import trimesh

    from gcnd.runs import Denoised

__all__ = ["check_confidence_path", "check_polygons_path", "load_source", "write_denoised"]


def load_source(
    source: Path, *paths: Path, triangulate: bool = False, confidence: bool = False
) -> trimesh.Trimesh:
    """Reads a mesh as far as its results need it, and checks that their files can hold what it has.

    Where all results are of the source's format, the parts of a .glb scene may differ in materials, as `save` with
    ``like`` leaves them alone.

    Args:
        source: The file.
        paths: Where its results will be written.
        triangulate: Whether faces of more than three corners are split for the work; see `gcnd.mesh_io.load`.
        confidence: Whether the results get a confidence by face, for which their files are made anew.

    Returns:
        The mesh.

    Raises:
        MeshError: It cannot be read, or what it refers to cannot be copied beside a result.
        ConfigError: See `check_polygons_path`.
    """
    is_same = all(path.suffix.lower() == source.suffix.lower() for path in paths)
    mesh = load(source, shape_only=is_same, triangulate=triangulate)
    for path in paths:
        check_polygons_path(mesh, source, path, confidence)
        if not confidence:
            check_copies(source, path)
    return mesh


def write_denoised(
    done: Denoised, path: Path, *, source: Path | None = None, confidence: bool = False
) -> None:
    """Writes a result that was read from a file, with its confidence as the face attribute ``confidence``.

    Args:
        done: What was found.
        path: Where to write.
        source: The file it was read from: of the same format, only its positions and normals change. Not with the
            confidence, for which the file is made anew.
        confidence: Whether to write the confidence.

    Raises:
        MeshError: The file cannot be written.
        ConfigError: See `check_confidence_path`; or there is no confidence.
    """
    mesh = done.mesh
    if confidence:
        check_confidence_path(path)
        if done.confidence is None:
            raise ConfigError("there is no confidence: nothing was predicted more than once")
        mesh = mesh.copy()
        mesh.face_attributes["confidence"] = done.confidence.astype(np.float32)
    save(mesh, path, like=None if confidence else source)


def check_confidence_path(path: Path) -> None:
    """Raises ``ConfigError`` where a format has no place for values by face."""
    if path.suffix.lower() != ".ply":
        raise ConfigError(f"{path}: only .ply holds a confidence by face", "name an output that ends in .ply")


def check_polygons_path(mesh: Any, source: Path, path: Path, confidence: bool = False) -> None:
    """Checks that faces split for the work can be written whole again, before any long work.

    Args:
        mesh: As `load` returns it.
        source: The file it was read from.
        path: Where the result will be written.
        confidence: Whether the result gets a confidence by face, for which its file is made anew.

    Raises:
        ConfigError: They cannot.
    """
    if "polygons" not in mesh.metadata:
        return
    if source.suffix.lower() != path.suffix.lower():
        raise ConfigError(
            f"{path}: faces of more than three corners stay whole only in a file of the input's format",
            f"name an output that ends in {source.suffix}",
        )
    if confidence:
        raise ConfigError("a confidence by face is for triangles, and the mesh has other faces")
