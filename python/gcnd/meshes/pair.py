"""Pairs (vertices, faces) of numpy arrays, torch tensors or lists."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import check_ids, polygon_error, triangles_of
from gcnd.formats.polygons import Polygons
from gcnd.meshes.arrays import TakenApart

__all__ = ["take_apart"]


def take_apart(mesh: Any, *, triangulate: bool = False) -> TakenApart:
    """Takes a pair apart; each member comes back in its own library, dtype and device.

    Vertices given as integers come back as float64. With ``triangulate`` faces may have more corners than three: rows
    of an array, or lists of different lengths, which come back as lists.
    """
    vertices, faces = mesh
    points = _as_numpy(vertices, "vertices")
    triangles, polygons = _split(points, faces) if triangulate else (None, None)

    def rebuild(moved: NDArray[np.float64]) -> tuple[Any, Any]:
        if _is_torch(faces):
            return _vertices_like(vertices, moved), faces.clone()
        is_ragged = triangles is not None and len({len(row) for row in faces}) > 1
        return _vertices_like(vertices, moved), [list(row) for row in faces] if is_ragged else np.array(faces)

    return TakenApart(
        points, _as_numpy(faces, "faces") if triangles is None else triangles, rebuild, polygons
    )


def _split(points: NDArray[Any], faces: Any) -> tuple[NDArray[np.int64] | None, Polygons | None]:
    """The triangles (T, 3) of faces of which some have more corners, and what they stand for; None where none has, or
    they are no faces."""
    lengths = [len(row) if hasattr(row, "__len__") else 0 for row in faces]
    if points.ndim != 2 or points.shape[1] != 3 or min(lengths, default=0) < 3 or max(lengths) == 3:
        return None, None
    rows = [_as_numpy(row, "faces") for row in faces]
    ids = np.concatenate(rows)
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        return None, None
    counts = np.array(lengths, dtype=np.int64)
    check_ids(ids.astype(np.int64), counts, len(points))
    corners, polygons = triangles_of(points.astype(np.float64), ids.astype(np.int64), counts)
    return ids.astype(np.int64)[corners], polygons


def _as_numpy(values: Any, what: str) -> NDArray[Any]:
    if _is_torch(values):
        try:
            values = values.detach().cpu()
            # numpy has no bfloat16, and every float that torch has fits in 64 bits.
            values = (values.double() if values.is_floating_point() else values).numpy()
        except (TypeError, NotImplementedError, RuntimeError) as error:
            raise MeshError(f"{what} are a tensor that numpy cannot hold: {error}") from error
    try:
        array = np.array(values)
    except ValueError:
        lengths = [len(row) if hasattr(row, "__len__") else 1 for row in values]
        bad = next((i for i, length in enumerate(lengths) if length != 3), 0)
        if what == "faces":
            raise polygon_error(bad, lengths[bad]) from None
        raise MeshError(f"vertex {bad} has {lengths[bad]} coordinates, not 3") from None
    if array.dtype.kind not in "iuf":
        raise MeshError(f"{what} are of type {array.dtype}, not numbers")
    return array


def _is_torch(values: Any) -> bool:
    # By name: torch is heavy, and whoever holds a tensor has imported it already.
    return type(values).__module__.partition(".")[0] == "torch"


def _vertices_like(old: Any, moved: NDArray[np.float64]) -> Any:
    if _is_torch(old):
        import torch

        dtype = old.dtype if old.is_floating_point() else torch.float64
        return torch.as_tensor(moved).to(device=old.device, dtype=dtype)
    kind = np.asarray(old).dtype
    return moved.astype(kind if kind.kind == "f" else np.float64)
