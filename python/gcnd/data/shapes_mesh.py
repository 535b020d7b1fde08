"""Measures of a triangle mesh that the procedural shapes are made and judged by."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gcnd.data.noise import FaceArray, FloatArray

FACE_RANGE = (9_000, 42_000)
"""Fewest and most faces of a shape."""


def face_crosses(vertices: FloatArray, faces: FaceArray) -> FloatArray:
    """Return (F, 3): each face's outward normal times twice its area.

    Example:
        >>> import numpy as np
        >>> face_crosses(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])).tolist()
        [[0.0, 0.0, 1.0]]
    """
    corners = vertices[faces]
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def edge_length_for(vertices: FloatArray, faces: FaceArray, n_faces: float) -> float:
    """Return the edge length of `n_faces` equilateral triangles with the mesh's area, in mesh units.

    Example:
        >>> import numpy as np
        >>> round(edge_length_for(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), 1.0), 4)
        1.0746
    """
    area = 0.5 * float(np.linalg.norm(face_crosses(vertices, faces), axis=1).sum())
    return float(np.sqrt(area / n_faces * 4 / np.sqrt(3)))


def triangle_quality(vertices: FloatArray, faces: FaceArray) -> FloatArray:
    """Return 4 sqrt(3) area / (sum of squared edges) of every face: 1 is equilateral, 0 has no area.

    Example:
        >>> import numpy as np
        >>> triangle_quality(np.eye(3), np.array([[0, 1, 2]], np.uint32)).round(6).tolist()
        [1.0]
    """
    corners = vertices[faces]
    squares = ((corners - np.roll(corners, -1, axis=1)) ** 2).sum(axis=(1, 2))
    doubled = np.linalg.norm(face_crosses(vertices, faces), axis=1)
    quality = np.divide(2 * np.sqrt(3) * doubled, squares, out=np.zeros(len(faces)), where=squares > 0)
    return np.asarray(quality, dtype=np.float64)


def edge_pairs(faces: FaceArray) -> npt.NDArray[np.int64] | None:
    """Return (E, 2) ids of the two faces at each edge of a closed, oriented mesh, or None for any other mesh.

    Example:
        >>> import numpy as np
        >>> edge_pairs(np.array([[0, 1, 2]], np.uint32)) is None
        True
    """
    starts, ends = faces.astype(np.int64), np.roll(faces, -1, axis=1).astype(np.int64)
    n = int(faces.max()) + 1
    forward, backward = (starts * n + ends).reshape(-1), (ends * n + starts).reshape(-1)
    by_forward, by_backward = np.argsort(forward, kind="stable"), np.argsort(backward, kind="stable")
    sorted_forward = forward[by_forward]
    if (np.diff(sorted_forward) == 0).any() or not np.array_equal(sorted_forward, backward[by_backward]):
        return None
    first, second = by_forward // 3, by_backward // 3
    return np.stack([first, second], axis=1)[first < second]


def is_sound(
    vertices: FloatArray,
    faces: FaceArray,
    *,
    sharp_angle: float = 180.0,
    sharp_share: float = 1.0,
    sliver_share: float = 0.002,
) -> bool:
    """Return whether a mesh can serve as ground truth.

    It has 9 to 42 thousand faces; every edge belongs to two faces that run through it in opposite directions; the
    volume is positive; no more than a share of the faces have a quality below 0.1; and no more than a share of the
    edges are sharper than an angle.

    Args:
        vertices: (V, 3) float64.
        faces: (F, 3) uint32.
        sharp_angle: Between the normals of two neighbouring faces, in degrees.
        sharp_share: Largest share of edges above that angle.
        sliver_share: Largest share of faces with a quality below 0.1.

    Returns:
        Whether all of this holds.

    Example:
        >>> import numpy as np
        >>> is_sound(np.eye(3), np.array([[0, 1, 2]], np.uint32))
        False
    """
    if not FACE_RANGE[0] <= len(faces) <= FACE_RANGE[1] or not np.isfinite(vertices).all():
        return False
    pairs = edge_pairs(faces)
    if pairs is None or np.mean(triangle_quality(vertices, faces) < 0.1) > sliver_share:
        return False
    crosses = face_crosses(vertices, faces)
    normals = crosses / np.maximum(np.linalg.norm(crosses, axis=1, keepdims=True), 1e-300)
    cosines = np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]])
    volume = np.einsum("ij,ij->", vertices[faces[:, 0]], crosses) / 6
    return bool(volume > 0 and np.mean(cosines < np.cos(np.radians(sharp_angle))) <= sharp_share)


def normalised(vertices: FloatArray) -> FloatArray:
    """Return vertices with the bounding box centred on the origin and its diagonal 1.

    Example:
        >>> import numpy as np
        >>> normalised(np.array([[0.0, 0, 0], [0, 3, 4]])).tolist()
        [[0.0, -0.3, -0.4], [0.0, 0.3, 0.4]]
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.asarray((vertices - 0.5 * (low + high)) / np.linalg.norm(high - low))


def subdivided(vertices: FloatArray, faces: FaceArray, normals: FloatArray) -> tuple[FloatArray, FaceArray]:
    """Return a mesh with every edge halved, the midpoints pushed out to where the surface curves to.

    A midpoint goes to the mean of its projections onto the tangent planes at both ends, three quarters of the way
    (Boubekeur and Alexa, Phong Tessellation, 2008).

    Args:
        vertices: (V, 3) float64.
        faces: (F, 3) uint32.
        normals: (V, 3) unit vertex normals.

    Returns:
        (V + E, 3) vertices and (4 F, 3) uint32 faces.

    Example:
        >>> import numpy as np
        >>> v, f = subdivided(np.eye(3), np.array([[0, 1, 2]], np.uint32), np.eye(3))
        >>> v.shape, f.shape
        ((6, 3), (4, 3))
    """
    n = len(vertices)
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].astype(np.int64), axis=2)
    keys, inverse = np.unique(pairs[..., 0] * n + pairs[..., 1], return_inverse=True)
    ends = np.stack([keys // n, keys % n])
    middle = vertices[ends].mean(axis=0)
    fall = np.einsum("kij,kij->ki", middle - vertices[ends], normals[ends])
    middle = middle - 0.75 * (fall[..., None] * normals[ends]).mean(axis=0)
    m0, m1, m2 = (n + inverse.reshape(-1, 3)).T
    a, b, c = faces.astype(np.int64).T
    parts = [(a, m0, m2), (m0, b, m1), (m2, m1, c), (m0, m1, m2)]
    new_faces = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.concatenate([vertices, middle]), new_faces.astype(np.uint32)
