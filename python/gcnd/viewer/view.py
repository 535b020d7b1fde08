"""Writing the page for two or three meshes, whatever kind they are."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd.errors import ConfigError, MeshError
from gcnd.formats.atomic import write_or_tell
from gcnd.mesh_io import check_output_path, read_shape
from gcnd.same_faces import split_alike
from gcnd.viewer.changes import Figures, compare_meshes
from gcnd.viewer.page import Names, view_page

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from gcnd.mesh_io import MeshArrays, MeshPath, Shape

__all__ = ["MAX_FACES", "view"]

MAX_FACES = 2_000_000
"""Faces of the largest mesh that a page takes; such a page has about 80 MB."""

_HINT = "give meshes that differ only in their positions, in formats with vertex order, such as PLY"


def view(
    after: Any,
    *,
    against: Any,
    truth: Any = None,
    confidence: ArrayLike | None = None,
    out: MeshPath = "view.html",
) -> Figures:
    """Writes one self-contained HTML page that shows a mesh before and after.

    The page opens in any browser with WebGL 2 and fetches nothing. It shows both meshes from one camera, side by side,
    with a wipe between them, or blended, plain or coloured by angular change (degrees a face), by error against the
    truth (degrees a face), by displacement (mean edge lengths a vertex) or by doubt (1 − confidence, percent a face).
    It shows faces of more than three corners as triangles, the same in all meshes.

    Args:
        after: The denoised mesh: whatever `gcnd.mesh_io.read_shape` takes: a path, a pair of arrays, a mesh object.
        against: The mesh before, with the same faces in the same order.
        truth: The true mesh, with the same faces in the same order, or None.
        confidence: By face (F,), 0 to 1, as `gcnd.denoise` returns it; by default the face attribute ``confidence`` of
            `after`, if it has one.
        out: The page to write, .html; an existing one is replaced.

    Returns:
        The figures on the page.

    Raises:
        MeshError: The meshes do not share their faces and their number of vertices, have more than `MAX_FACES` faces,
            or cannot be read; see `gcnd.mesh_io.read_shape`.
        ConfigError: `out` is not called .html; or the confidence is not one number from 0 to 1 for each face.
        GcndError: The page cannot be written, or would replace one of the meshes, also through a link. What stood at
            `out` then still does.

    Example:
        >>> figures = view("clean.ply", against="noisy.ply", out="view.html")  # doctest: +SKIP
        >>> figures.displacement_max  # doctest: +SKIP
        0.82
    """
    path = Path(out)
    _check_page_path(path, *(mesh for mesh in (after, against, truth) if isinstance(mesh, str | os.PathLike)))
    names = Names(
        _name(against, "before"), _name(after, "after"), None if truth is None else _name(truth, "truth")
    )
    before, shape = read_shape(against), read_shape(after)
    before_mesh, after_mesh = before.arrays, _pair(shape, before, (names.after, names.before))
    truth_mesh = None
    if truth is not None:
        truth_mesh = _pair(read_shape(truth), before, (names.truth or "truth", names.before))
    if len(before_mesh.faces) > MAX_FACES:
        raise MeshError(
            f"{names.before} has {len(before_mesh.faces)} faces, and a page takes at most {MAX_FACES}",
            "cut out the part of interest from each mesh, and view that",
        )
    if confidence is None:
        confidence = shape.face_attributes.get("confidence")
    known = None if confidence is None else _checked_confidence(confidence, len(after_mesh.faces))
    layers, figures = compare_meshes(before_mesh, after_mesh, truth_mesh, known)
    page = view_page(before_mesh, after_mesh, layers, figures, names)
    # Names of files may have bytes that are no UTF-8.
    write_or_tell(path, page)
    return figures


def _checked_confidence(confidence: ArrayLike, n_faces: int) -> NDArray[np.float64]:
    try:
        given = np.asarray(confidence)
    except ValueError:  # rows of different lengths
        given = np.empty(0, dtype=object)
    if given.dtype.kind not in "biuf":
        raise ConfigError("confidence is no array of numbers, allowed: one for each face, 0 to 1")
    values = given.astype(np.float64).reshape(-1)
    if len(values) != n_faces:
        raise ConfigError(f"confidence has {len(values)} values, and the mesh {n_faces} faces")
    if not ((values >= 0) & (values <= 1)).all():
        raise ConfigError("confidence has values outside 0 to 1")
    return values


def _pair(mesh: Shape, before: Shape, names: tuple[str, str]) -> MeshArrays:
    """The mesh with the triangles of the one before."""
    alike = split_alike(mesh, before, names, _HINT)
    counts = len(alike.vertices), len(before.arrays.vertices)
    if counts[0] != counts[1]:
        raise MeshError(f"{names[0]} has {counts[0]} vertices and {names[1]} has {counts[1]}", _HINT)
    return alike


def _check_page_path(path: Path, *meshes: MeshPath) -> None:
    if path.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"{path} is not the name of a page", hint="end it in .html")
    check_output_path(path, *meshes, is_mesh=False)


def _name(mesh: Any, otherwise: str) -> str:
    return Path(mesh).name if isinstance(mesh, str | os.PathLike) else otherwise
