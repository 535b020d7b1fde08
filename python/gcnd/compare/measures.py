"""How far a denoised mesh is from the truth, in every number that the comparison shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gcnd.data.noise import mean_edge_length
from gcnd.metrics import normal_angles, vertex_error

if TYPE_CHECKING:
    from gcnd.compare.adapters.base import Faces, Vertices

__all__ = ["Measures", "enclosed_volume", "measure"]


@dataclass(frozen=True)
class Measures:
    """Holds the errors of one result.

    Attributes:
        e_a: Mean angle between the normals of result and truth, degrees.
        e_v: Mean distance between points of both surfaces over the truth's bounding-box diagonal, times 1000.
        displacement_mean: Mean distance of a vertex from its place in the truth, in the truth's mean edge lengths.
        displacement_max: The largest such distance.
        flipped: Faces whose normal is more than 90° from the truth's.
        volume_change: Enclosed volume over the truth's, less one, in percent; None for meshes that are not closed.
    """

    e_a: float
    e_v: float
    displacement_mean: float
    displacement_max: float
    flipped: int
    volume_change: float | None


def measure(result: Vertices, truth: Vertices, faces: Faces, *, samples: int) -> Measures:
    """Computes every error of a result.

    Args:
        result: Positions (V, 3), finite.
        truth: Positions (V, 3) of the truth.
        faces: Vertex ids (F, 3) of both. Vertices without a face do not count.
        samples: Points on each surface for E_v.

    Raises:
        MeshError: A position is not finite.

    Example:
        >>> import numpy as np
        >>> corner, faces = np.eye(3), np.array([[0, 1, 2]])
        >>> round(measure(corner + [0, 0, np.sqrt(2)], corner, faces, samples=10).displacement_max, 6)
        1.0
    """
    angles = normal_angles(result, truth, faces)
    distance = np.linalg.norm(result - truth, axis=1)[np.unique(faces)]
    scale = mean_edge_length(truth, faces) or 1.0
    before = enclosed_volume(truth, faces)
    after = enclosed_volume(result, faces)
    volume_change = None if not before or after is None else 100 * (after - before) / abs(before)
    return Measures(
        e_a=float(np.nanmean(angles)),
        e_v=1000 * vertex_error(result, faces, truth, faces, samples),
        displacement_mean=float(distance.mean() / scale),
        displacement_max=float(distance.max() / scale),
        flipped=int(np.count_nonzero(angles > 90.0)),
        volume_change=volume_change,
    )


def enclosed_volume(vertices: Vertices, faces: Faces) -> float | None:
    """Computes the volume inside a closed mesh: the sum over its faces of p_0 · (p_1 × p_2) / 6.

    Args:
        vertices: Positions (V, 3).
        faces: Vertex ids (F, 3).

    Returns:
        Cubed mesh units, positive where faces point outward; None where an edge is not run through as often in one
        direction as in the other, so that there is no inside.

    Example:
        >>> import numpy as np
        >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> round(6 * enclosed_volume(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])), 6)
        1.0
    """
    ids = faces.astype(np.int64)
    start = ids.reshape(-1)
    end = ids[:, [1, 2, 0]].reshape(-1)
    n = int(ids.max()) + 1
    if not np.array_equal(np.sort(start * n + end), np.sort(end * n + start)):
        return None
    # Around the middle, so that far from the origin no digits are lost.
    corners = (vertices - vertices[start].mean(axis=0))[ids]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)
