"""Pairs (vertices, faces) of numpy arrays, torch tensors or lists."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import polygon_error
from gcnd.meshes.arrays import TakenApart

__all__ = ["take_apart"]


def take_apart(mesh: Any) -> TakenApart:
    """Takes a pair apart; each member comes back in its own library, dtype and device.

    Vertices given as integers come back as float64.
    """
    vertices, faces = mesh

    def rebuild(moved: NDArray[np.float64]) -> tuple[Any, Any]:
        return _vertices_like(vertices, moved), faces.clone() if _is_torch(faces) else np.array(faces)

    return TakenApart(_as_numpy(vertices, "vertices"), _as_numpy(faces, "faces"), rebuild)


def _as_numpy(values: Any, what: str) -> NDArray[Any]:
    if _is_torch(values):
        values = values.detach().cpu()
        # numpy has no bfloat16, and every float that torch has fits in 64 bits.
        values = (values.double() if values.is_floating_point() else values).numpy()
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
