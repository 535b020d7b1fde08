"""How far a denoised mesh is from the truth: E_a in degrees, E_v over the bounding-box diagonal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gcnd import _geom
from gcnd.errors import check_count
from gcnd.forks import refuse_fork
from gcnd.mesh_io import to_arrays

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def normal_angles(
    result_vertices: ArrayLike, truth_vertices: ArrayLike, faces: ArrayLike
) -> NDArray[np.float64]:
    """Computes the angle between each face's normals in two meshes that share their faces.

    Args:
        result_vertices: Positions (V, 3) of the result.
        truth_vertices: Positions (V, 3) of the truth.
        faces: Vertex ids (F, 3) of both.

    Returns:
        Degrees (F,); NaN where the truth's face has no area, 90 where only the result's has none.

    Raises:
        MeshError: An index is out of range, a coordinate is not finite or there are no faces.

    Paper: Sec. 7.2, Eq. 7, before averaging.
    """
    meshes = [to_arrays((vertices, faces))[0] for vertices in (result_vertices, truth_vertices)]
    refuse_fork()
    result, truth = (_geom.face_geometry(mesh.vertices, mesh.faces)[0] for mesh in meshes)
    return _geom.normal_angles(result, truth)


def normal_error(result_vertices: ArrayLike, truth_vertices: ArrayLike, faces: ArrayLike) -> float:
    """Computes E_a, the mean angle between the normals of a result and of the truth.

    E_a = 1/N_f Σ_i acos(n_i · ñ_i), in degrees, over faces that have an area in the truth.

    Args:
        result_vertices: Positions (V, 3) of the result.
        truth_vertices: Positions (V, 3) of the truth.
        faces: Vertex ids (F, 3) of both.

    Returns:
        Degrees; NaN when no face of the truth has an area.

    Raises:
        MeshError: An index is out of range, a coordinate is not finite or there are no faces.

    Paper: Sec. 7.2, Eq. 7.

    Example:
        >>> import numpy as np
        >>> corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> round(normal_error(corner @ [[1, 0, 0], [0, 0, 1], [0, 1, 0]], corner, [[0, 1, 2]]), 6)
        90.0
    """
    angles = normal_angles(result_vertices, truth_vertices, faces)
    known = angles[~np.isnan(angles)]
    return float(known.mean()) if len(known) else float("nan")


def vertex_error(
    result_vertices: ArrayLike,
    result_faces: ArrayLike,
    truth_vertices: ArrayLike,
    truth_faces: ArrayLike,
    samples: int = 200_000,
    seed: int = 0,
) -> float:
    """Computes E_v, the mean distance from points of a result to the truth over its bounding-box diagonal.

    E_v = 1/(N L_d) Σ_i min_j ‖v_i − ṽ_j‖ over ``samples`` seeded points on each surface, point to point.

    Args:
        result_vertices: Positions (V, 3) of the result.
        result_faces: Vertex ids (F, 3) of the result.
        truth_vertices: Positions (V', 3) of the truth.
        truth_faces: Vertex ids (F', 3) of the truth.
        samples: Points on each surface.
        seed: Of the points.

    Returns:
        A fraction of the diagonal; tables print it times 1000.

    Raises:
        MeshError: An index is out of range, a coordinate is not finite or a mesh is empty.
        ConfigError: The number of samples or the seed is out of range, or the truth is a single point.

    Paper: Sec. 7.2, Eq. 8. Choice: docs/choices.md#vertex-error.
    """
    samples, seed = check_count("samples", samples), check_count("seed", seed)
    result, _ = to_arrays((result_vertices, result_faces))
    truth, _ = to_arrays((truth_vertices, truth_faces))
    refuse_fork()
    return _geom.vertex_error(result.vertices, result.faces, truth.vertices, truth.faces, samples, seed)
