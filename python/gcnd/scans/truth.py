"""The truth of a mesh that was reconstructed: its vertices on the clean surface, without folds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse

from gcnd import _geom
from gcnd.data.noise import AnyFaces, FaceArray, FloatArray, vertex_normals
from gcnd.scans.closest import Surface
from gcnd.scans.sides import find_sides
from gcnd.scans.window import BoolArray

_UNFOLDING_ROUNDS = 15


def project_truth(
    noisy: FloatArray, faces: FaceArray, clean_vertices: FloatArray, clean_faces: AnyFaces
) -> tuple[FloatArray, BoolArray]:
    """Moves every vertex of a reconstruction to the nearest point of the clean surface.

    Nearest points of a noisy surface can lie in another order than its vertices, and then faces of the truth are
    folded: they look away from the surface that they lie on. E_a compares normals face by face, so the vertices of
    folded faces are moved to the mean of their neighbours and put on the surface again, at most 15 times.

    Args:
        noisy: (V, 3) float64.
        faces: (F, 3) of the reconstruction.
        clean_vertices: (W, 3) float64.
        clean_faces: (G, 3). Which side of a closed body is out is found by `find_sides`, whatever the order of their
            corners; a face of an open one looks to where the reconstruction's vertex does, for it is seen from both.

    Returns:
        (V, 3), on the clean surface; and (F,), which faces are folded still.

    Choice: docs/choices.md#truth-of-a-fused-scan.
    """
    surface = Surface(clean_vertices, clean_faces)
    sides, outward = find_sides(clean_vertices, clean_faces), vertex_normals(noisy, faces)
    truth, hit = surface.nearest(noisy)
    neighbors = _neighbor_mean(faces, len(noisy))
    folded = is_folded(truth, faces, sides.towards(hit, outward))
    for _ in range(_UNFOLDING_ROUNDS):
        if not folded.any():
            break
        moved = np.unique(faces[folded])
        truth[moved], hit[moved] = surface.nearest((neighbors @ truth)[moved])
        folded = is_folded(truth, faces, sides.towards(hit, outward))
    return truth, folded


def is_folded(truth: FloatArray, faces: FaceArray, vertex_normals: FloatArray) -> BoolArray:
    """Says which faces have no normal, or one more than 90° from that of the surface at every corner.

    Args:
        truth: (V, 3) float64.
        faces: (F, 3), vertex ids.
        vertex_normals: (V, 3), of the surface at each vertex.

    Returns:
        (F,).

    Example:
        >>> up = np.tile([0.0, 0, 1], (3, 1))
        >>> is_folded(np.eye(3) * [1, 1, 0], np.array([[0, 1, 2], [2, 1, 0]], np.uint32), up).tolist()
        [False, True]
    """
    normals = _geom.face_geometry(np.ascontiguousarray(truth), np.ascontiguousarray(faces))[0]
    agreement = np.einsum("fx,fcx->fc", normals, vertex_normals[faces])
    folded: BoolArray = agreement.max(axis=1) <= 0
    return folded


def _neighbor_mean(faces: npt.NDArray[np.uint32], n_vertices: int) -> sparse.csr_array:
    """(V, V): the mean over the vertices that share an edge, each counted once a face."""
    start = faces[:, [0, 1, 2, 1, 2, 0]].reshape(-1).astype(np.int64)
    end = faces[:, [1, 2, 0, 0, 1, 2]].reshape(-1).astype(np.int64)
    weights = 1.0 / np.bincount(start, minlength=n_vertices)[start]
    return sparse.csr_array((weights, (start, end)), shape=(n_vertices, n_vertices))
