"""Faces that a mesh has more than once: each counts once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gcnd.mesh_io import MeshArrays

__all__ = ["without_repeats"]


def without_repeats(mesh: MeshArrays) -> tuple[MeshArrays, NDArray[np.int64] | None]:
    """Leaves out faces whose three corners are those of an earlier face, in whatever order.

    Args:
        mesh: With each position once, (V, 3) and (F, 3).

    Returns:
        The mesh with the first of each, in the same order and direction; and of every face of ``mesh`` its place among
        them (F,). Where no face is repeated, ``mesh`` itself and None.

    Choice: docs/choices.md#repeated-faces.

    Example:
        >>> from gcnd.mesh_io import to_arrays
        >>> faces = [[0, 1, 2], [2, 1, 0], [0, 2, 3], [1, 2, 0]]
        >>> once, place = without_repeats(to_arrays(([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], faces))[0])
        >>> once.faces.tolist(), place.tolist()
        ([[0, 1, 2], [0, 2, 3]], [0, 0, 1, 0])
    """
    first = _first_alike(mesh.faces)
    if first is None:
        return mesh, None
    is_first = first == np.arange(len(first))
    place = np.cumsum(is_first, dtype=np.int64) - 1
    return MeshArrays(mesh.vertices, mesh.faces[is_first]), place[first]


def _keys(faces: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """A number for each face (F,) that does not depend on the order of its corners; others have it by chance only."""
    # The sum of three numbers as good as random, one a vertex: splitmix64, whose products overflow by design.
    numbers = np.arange(1, int(faces.max()) + 2, dtype=np.uint64)
    numbers *= np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        numbers ^= numbers >> np.uint64(shift)
        numbers *= np.uint64(factor)
    numbers ^= numbers >> np.uint64(31)
    keys = numbers[faces[:, 0]]
    keys += numbers[faces[:, 1]]
    keys += numbers[faces[:, 2]]
    return keys


def _first_alike(faces: NDArray[np.uint32]) -> NDArray[np.int64] | None:
    """Of every face the first one with its corners (F,), which may be itself; None where all are."""
    n_faces = len(faces)
    # Key and face in one number: sorting those is many times faster than sorting faces by key.
    bits = np.uint64(n_faces.bit_length())
    keys = _keys(faces)
    keys <<= bits
    keys |= np.arange(n_faces, dtype=np.uint64)
    keys.sort()
    order = (keys & ((np.uint64(1) << bits) - np.uint64(1))).astype(np.int64)
    keys >>= bits
    is_alike = keys[1:] == keys[:-1]
    if not is_alike.any():
        return None
    begins = np.arange(n_faces)
    begins[1:][is_alike] = 0
    first = np.empty(n_faces, dtype=np.int64)
    first[order] = order[np.maximum.accumulate(begins)]
    # Some share a key by chance: they are compared by their corners.
    later = np.flatnonzero(first != np.arange(n_faces))
    others = later[_differ(faces[later], faces[first[later]])]
    if len(others):
        corners = np.sort(faces[others], axis=1)
        _, index, inverse = np.unique(corners, axis=0, return_index=True, return_inverse=True)
        first[others] = others[index[inverse.reshape(-1)]]
    return None if (first == np.arange(n_faces)).all() else first


def _differ(faces: NDArray[np.uint32], others: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Whether two faces each have other corners (F,), whatever their order."""
    # The least, the largest and the sum of three say which they are, also where the sum overflows.
    (a, b, c), (d, e, f) = faces.T, others.T
    differ: NDArray[np.bool_] = np.minimum(np.minimum(a, b), c) != np.minimum(np.minimum(d, e), f)
    differ |= np.maximum(np.maximum(a, b), c) != np.maximum(np.maximum(d, e), f)
    differ |= a + b + c != d + e + f
    return differ
