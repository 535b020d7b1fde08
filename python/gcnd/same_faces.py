"""Whether two meshes differ only in positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gcnd.errors import MeshError
from gcnd.meshes.arrays import MeshArrays

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from gcnd.meshes.arrays import Shape

__all__ = ["split_alike"]


def split_alike(first: Shape, second: Shape, names: tuple[str, str], hint: str | None = None) -> MeshArrays:
    """Gives a mesh the triangles of another that has the same faces in the same order.

    What compares face i with face i needs that. A face of more than three corners is split by its shape, so that each
    mesh alone could have it split in a way of its own.

    Args:
        first: One mesh.
        second: The other.
        names: What the error calls them.
        hint: What the error advises.

    Returns:
        The vertices of the first with the triangles of the second.

    Raises:
        MeshError: The numbers of faces differ, or a face has other corners.

    Example:
        >>> from gcnd.mesh_io import read_shape
        >>> two = [read_shape((np.eye(3), [corners])) for corners in ([0, 1, 2], [1, 2, 0])]
        >>> split_alike(two[0], two[1], ("a.ply", "b.ply"))
        Traceback (most recent call last):
        gcnd.errors.MeshError: face 0 is (0, 1, 2) in a.ply and (1, 2, 0) in b.ply
    """
    if first.n_faces != second.n_faces:
        raise MeshError(f"{names[0]} has {first.n_faces} faces and {names[1]} has {second.n_faces}", hint)
    (ids, lengths), (other_ids, other_lengths) = _corners(first), _corners(second)
    differs = lengths != other_lengths
    if not differs.any():
        starts = np.cumsum(lengths) - lengths
        differs = np.logical_or.reduceat(ids != other_ids, starts)
    if differs.any():
        face_id = int(differs.argmax())
        ends = (np.cumsum(lengths)[face_id], np.cumsum(other_lengths)[face_id])
        told = [
            tuple(ids[ends[0] - lengths[face_id] : ends[0]].tolist()),
            tuple(other_ids[ends[1] - other_lengths[face_id] : ends[1]].tolist()),
        ]
        raise MeshError(f"face {face_id} is {told[0]} in {names[0]} and {told[1]} in {names[1]}", hint)
    return MeshArrays(first.arrays.vertices, second.arrays.faces)


def _corners(shape: Shape) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The vertices of all faces (C,), one face after the other, and how many corners each has (F,)."""
    faces = shape.arrays.faces.astype(np.int64)
    if shape.polygons is None:
        return faces.ravel(), np.full(len(faces), 3)
    lengths = np.bincount(shape.polygons.owner) + 2
    ids = np.empty(int(lengths.sum()), dtype=np.int64)
    ids[shape.polygons.corners] = faces
    return ids, lengths
