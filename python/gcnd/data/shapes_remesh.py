"""Triangles as found in the wild: even, graded, stretched, jittered or left rough by the remeshing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gcnd import _geom
from gcnd.data.noise import FaceArray, FloatArray, mean_edge_length, smoothed, vertex_normals
from gcnd.data.shapes_field import SmoothNoise
from gcnd.data.shapes_mesh import FACE_RANGE, edge_length_for, face_crosses, triangle_quality

_MAX_GRADING = 2.5
"""Sizes lie within this factor of the mean size."""

_JITTER_ANGLE = 3.0
"""Vertices whose faces differ from their normal by more degrees are not jittered: they would leave the surface."""


@dataclass(frozen=True)
class TriangleStyle:
    """How regular a mesh's triangles are.

    Attributes:
        iterations: Rounds of remeshing; fewer leave triangles rougher.
        noise: Log-deviation of the wanted edge length in space, 0 for even triangles.
        wavelength: Of that variation, for bodies about 1 across.
        curvature: Exponent with which sizes fall where the surface bends, 0 for not at all.
        stretch: Factor by which triangles are longer across one axis.
        jitter: Deviation of vertices within the surface, in mean edge lengths.
    """

    iterations: int = 8
    noise: float = 0.0
    wavelength: float = 0.5
    curvature: float = 0.0
    stretch: float = 1.0
    jitter: float = 0.0


def draw_style(rng: np.random.Generator, *, irregular: float = 0.6) -> TriangleStyle:
    """Return a random style; the share `irregular` of them is anything but even.

    Example:
        >>> import numpy as np
        >>> draw_style(np.random.default_rng(0), irregular=0.0)
        TriangleStyle(iterations=8, noise=0.0, wavelength=0.5, curvature=0.0, stretch=1.0, jitter=0.0)
    """
    if rng.random() >= irregular:
        return TriangleStyle()
    graded = rng.random() < 0.6
    return TriangleStyle(
        iterations=int(rng.integers(1, 9)),
        noise=float(rng.uniform(0.1, 0.45)) if graded else 0.0,
        wavelength=float(np.exp(rng.uniform(np.log(0.06), np.log(0.8)))),
        curvature=float(rng.uniform(0.1, 0.4)) if rng.random() < 0.4 else 0.0,
        stretch=float(rng.uniform(1.2, 1.9)) if rng.random() < 0.25 else 1.0,
        jitter=float(rng.uniform(0.03, 0.2)) if rng.random() < 0.5 else 0.0,
    )


def remeshed(
    rng: np.random.Generator,
    vertices: FloatArray,
    faces: FaceArray,
    *,
    n_faces: float,
    feature_angle: float,
    style: TriangleStyle,
) -> tuple[FloatArray, FaceArray]:
    """Return a mesh of about `n_faces` triangles in a style, its sharp edges kept.

    Args:
        rng: Draws what the style leaves open.
        vertices: (V, 3) float64, fine enough that wanted lengths may be set at the vertices.
        faces: (F, 3) uint32.
        n_faces: Narrow features make more; the length is corrected once if the count leaves 9 to 42 thousand.
        feature_angle: Sharper edges are kept, in degrees.
        style: How regular the triangles are.

    Returns:
        New vertices and faces on the same surface.

    Example:
        >>> import numpy as np
        >>> from gcnd.data.shapes_organic import smooth_body
        >>> rng = np.random.default_rng(0)
        >>> _, v, f = smooth_body(rng)
        >>> _, new = remeshed(rng, v, f, n_faces=1e4, feature_angle=180.0, style=TriangleStyle())
        >>> abs(len(new) - 1e4) < 1e3
        True
    """
    frame = np.eye(3)
    frame[int(rng.integers(3))] *= style.stretch
    factors = _size_factors(rng, vertices, faces, style)
    placed = vertices @ frame
    length = edge_length_for(placed, faces, n_faces)
    for _ in range(2):
        new_vertices, new_faces = _geom.remesh(
            placed,
            faces,
            length,
            feature_angle_deg=feature_angle,
            iterations=style.iterations,
            sizes=None if factors is None else length * factors,
        )
        if FACE_RANGE[0] <= len(new_faces) <= FACE_RANGE[1]:
            break
        length *= float(np.sqrt(len(new_faces) / n_faces))
    new_vertices = np.ascontiguousarray(new_vertices @ np.linalg.inv(frame))
    if style.jitter > 0:
        new_vertices = jittered(rng, new_vertices, new_faces, style.jitter)
    return new_vertices, new_faces


def _size_factors(
    rng: np.random.Generator, vertices: FloatArray, faces: FaceArray, style: TriangleStyle
) -> FloatArray | None:
    """The wanted edge length at each vertex over the mean one, or None for the same everywhere."""
    if style.noise == 0 and style.curvature == 0:
        return None
    factors = np.exp(style.noise * SmoothNoise(rng, style.wavelength)(vertices))
    if style.curvature > 0:
        bend = _bending(vertices, faces)
        factors *= (np.median(bend) / np.maximum(bend, 1e-9)) ** style.curvature
    factors = np.clip(factors, 1 / _MAX_GRADING, _MAX_GRADING)
    area = np.bincount(
        faces.reshape(-1), np.repeat(np.linalg.norm(face_crosses(vertices, faces), axis=1), 3), len(vertices)
    )
    # A triangle's area goes with the square of its size, so this keeps the number of faces.
    return np.asarray(factors * np.sqrt((area / factors**2).sum() / area.sum()))


def _bending(vertices: FloatArray, faces: FaceArray) -> FloatArray:
    """How much normals differ over an edge at each vertex, smoothed and bounded from below; (V,)."""
    normals = vertex_normals(vertices, faces)
    bend = np.zeros(len(vertices))
    for i in range(3):
        a, b = faces[:, i], faces[:, (i + 1) % 3]
        step = np.linalg.norm(vertices[a] - vertices[b], axis=1)
        turn = np.linalg.norm(normals[a] - normals[b], axis=1) / np.maximum(step, 1e-12)
        np.maximum.at(bend, a, turn)
        np.maximum.at(bend, b, turn)
    bend = smoothed(bend, faces, 5)
    return np.maximum(bend, 0.2 * np.median(bend) + 1e-9)


def jittered(rng: np.random.Generator, vertices: FloatArray, faces: FaceArray, amount: float) -> FloatArray:
    """Return vertices moved at random within their tangent plane, where the surface is flat enough.

    Args:
        rng: Draws the moves.
        vertices: (V, 3) float64.
        faces: (F, 3).
        amount: Standard deviation in mean edge lengths.

    Returns:
        (V, 3) float64; vertices whose faces' normals differ from theirs by more than 3 degrees stay, as do those
        that would spoil a triangle.

    Example:
        >>> import numpy as np
        >>> flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> jittered(np.random.default_rng(0), flat, np.array([[0, 1, 2]]), 0.1)[:, 2].tolist()
        [0.0, 0.0, 0.0]
    """
    normals = vertex_normals(vertices, faces)
    step = rng.standard_normal(vertices.shape) * amount * mean_edge_length(vertices, faces)
    step -= normals * np.einsum("ij,ij->i", step, normals)[:, None]
    step[~_flat_vertices(vertices, faces, normals, float(np.cos(np.radians(_JITTER_ANGLE))))] = 0.0
    old_crosses = face_crosses(vertices, faces)
    for shrink in (0.3, 0.3, 0.3, 0.0):
        moved = vertices + step
        turned = np.einsum("ij,ij->i", face_crosses(moved, faces), old_crosses) <= 0
        bad = turned | (triangle_quality(moved, faces) < 0.25)
        if not bad.any():
            break
        step[np.unique(faces[bad])] *= shrink
    return np.asarray(vertices + step)


def _flat_vertices(
    vertices: FloatArray, faces: FaceArray, normals: FloatArray, min_cos: float
) -> npt.NDArray[np.bool_]:
    """Mark the vertices all of whose faces are within an angle of the vertex normal."""
    crosses = face_crosses(vertices, faces)
    unit = crosses / np.maximum(np.linalg.norm(crosses, axis=1, keepdims=True), 1e-300)
    flat = np.ones(len(vertices), dtype=bool)
    for slot in range(3):
        ids = faces[:, slot]
        flat[ids[np.einsum("ij,ij->i", unit, normals[ids]) < min_cos]] = False
    return flat
