"""Procedural training shapes: clean closed meshes of machine parts, smooth and detailed bodies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from gcnd import _geom
from gcnd.data.noise import mean_edge_length, vertex_normals
from gcnd.data.shapes_cad import cad_solid
from gcnd.data.shapes_detail import add_relief
from gcnd.data.shapes_organic import FaceArray, FloatArray, smooth_body
from gcnd.errors import ConfigError

ShapeKind = Literal["cad", "smooth", "feature"]
"""Machine parts, smooth bodies, and smooth bodies with fine relief: the paper's three groups."""

SHAPE_KINDS: tuple[ShapeKind, ...] = get_args(ShapeKind)

FACE_RANGE = (9_000, 42_000)
"""Fewest and most faces of a shape."""

_CAD_FEATURE_ANGLE = 18.0
_MAX_ATTEMPTS = 12


@dataclass(frozen=True)
class Shape:
    """A clean closed mesh with unit bounding-box diagonal, centred on the origin.

    Attributes:
        name: Kind, family and seed, unique among shapes.
        kind: One of `SHAPE_KINDS`.
        vertices: (V, 3) float64.
        faces: (F, 3) uint32, anticlockwise seen from outside.
    """

    name: str
    kind: ShapeKind
    vertices: FloatArray
    faces: FaceArray


def make_shape(seed: int, kind: ShapeKind | None = None) -> Shape:
    """Return the procedural shape of a seed: 9 to 42 thousand faces, closed, oriented outward.

    ``cad``: primitives and profiles joined and cut, sharp edges kept by the remeshing. ``smooth``: implicit and
    parametric bodies. ``feature``: smooth bodies with relief of wavelengths from 4 to 20 edge lengths. Triangles are
    isotropic, graded, or irregular.

    Args:
        seed: Any integer >= 0; the same seed and kind give the same shape.
        kind: One of `SHAPE_KINDS`, or None to draw half ``cad`` and a quarter each of the others.

    Returns:
        The shape, unit bounding-box diagonal.

    Raises:
        ConfigError: An unknown kind or a negative seed.

    Paper: Sec. 7.1 trains on CAD, smooth and feature models. Choice: docs/choices.md#training-shapes (procedural
    shapes in place of collected models).

    Example:
        >>> shape = make_shape(0, "smooth")
        >>> 9_000 <= len(shape.faces) <= 42_000
        True
    """
    if seed < 0:
        raise ConfigError(f"shape seed is {seed}", hint="use an integer >= 0")
    if kind is not None and kind not in SHAPE_KINDS:
        raise ConfigError(f"unknown shape kind {kind!r}", hint=f"use one of {', '.join(SHAPE_KINDS)}")
    if kind is None:
        kind = SHAPE_KINDS[int(np.random.default_rng([seed, 9]).choice(3, p=[0.5, 0.25, 0.25]))]
    for attempt in range(_MAX_ATTEMPTS):
        rng = np.random.default_rng([seed, SHAPE_KINDS.index(kind), attempt])
        family, vertices, faces = _MAKERS[kind](rng)
        if is_sound(vertices, faces):
            return Shape(f"{kind}-{family}-{seed}", kind, normalised(vertices), faces)
    raise RuntimeError(f"no sound {kind} shape from seed {seed} in {_MAX_ATTEMPTS} attempts")


def normalised(vertices: FloatArray) -> FloatArray:
    """Return vertices with the bounding box centred on the origin and its diagonal 1.

    Example:
        >>> import numpy as np
        >>> normalised(np.array([[0.0, 0, 0], [0, 3, 4]])).tolist()
        [[0.0, -0.3, -0.4], [0.0, 0.3, 0.4]]
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.asarray((vertices - 0.5 * (low + high)) / np.linalg.norm(high - low))


def is_sound(vertices: FloatArray, faces: FaceArray) -> bool:
    """Return whether a mesh can serve as ground truth.

    It has 9 to 42 thousand faces, every edge belongs to two faces that run through it in opposite directions, the
    volume is positive, and fewer than 1 in 200 faces have a quality below 0.1 (1 is equilateral).

    Example:
        >>> import numpy as np
        >>> is_sound(np.eye(3), np.array([[0, 1, 2]], np.uint32))
        False
    """
    if not FACE_RANGE[0] <= len(faces) <= FACE_RANGE[1] or not np.isfinite(vertices).all():
        return False
    starts, ends = faces.astype(np.int64), np.roll(faces, -1, axis=1).astype(np.int64)
    n = len(vertices)
    forward, backward = (starts * n + ends).reshape(-1), (ends * n + starts).reshape(-1)
    if len(np.unique(forward)) != len(forward) or not np.array_equal(np.sort(forward), np.sort(backward)):
        return False
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.einsum("ij,ij->", corners[:, 0], cross) / 6
    return bool(volume > 0 and np.mean(triangle_quality(vertices, faces) < 0.1) < 0.005)


def triangle_quality(vertices: FloatArray, faces: FaceArray) -> FloatArray:
    """Return 4 sqrt(3) area / (sum of squared edges) of every face: 1 is equilateral, 0 has no area.

    Example:
        >>> import numpy as np
        >>> triangle_quality(np.eye(3), np.array([[0, 1, 2]])).round(6).tolist()
        [1.0]
    """
    corners = vertices[faces]
    edges = corners - np.roll(corners, -1, axis=1)
    doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    squares = (edges**2).sum(axis=(1, 2))
    return np.divide(2 * np.sqrt(3) * doubled, squares, out=np.zeros(len(faces)), where=squares > 0)


def _surface_area(vertices: FloatArray, faces: FaceArray) -> float:
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(cross, axis=1).sum())


def _edge_length_for(vertices: FloatArray, faces: FaceArray, n_faces: float) -> float:
    """The edge length of `n_faces` equilateral triangles with the mesh's area."""
    return float(np.sqrt(_surface_area(vertices, faces) / n_faces * 4 / np.sqrt(3)))


def _draw_face_count(rng: np.random.Generator) -> float:
    """Even in the logarithm, away from the ends of the range, which remeshing misses by some percent."""
    return float(np.exp(rng.uniform(np.log(1.25 * FACE_RANGE[0]), np.log(0.85 * FACE_RANGE[1]))))


def _remeshed(
    vertices: FloatArray, faces: FaceArray, n_faces: float, feature_angle: float, iterations: int
) -> tuple[FloatArray, FaceArray]:
    """Remesh to about `n_faces`; narrow features make more faces, so the length is corrected once if need be."""
    length = _edge_length_for(vertices, faces, n_faces)
    for _ in range(2):
        new_vertices, new_faces = _geom.remesh(
            vertices, faces, length, feature_angle_deg=feature_angle, iterations=iterations
        )
        if FACE_RANGE[0] <= len(new_faces) <= FACE_RANGE[1]:
            break
        length *= float(np.sqrt(len(new_faces) / n_faces))
    return new_vertices, new_faces


def _make_cad(rng: np.random.Generator) -> tuple[str, FloatArray, FaceArray]:
    family, solid = cad_solid(rng)
    mesh = solid.to_mesh64()
    vertices = np.ascontiguousarray(mesh.vert_properties[:, :3], dtype=np.float64)
    faces = np.ascontiguousarray(mesh.tri_verts, dtype=np.uint32)
    if len(faces) == 0:
        return family, vertices, faces
    style = rng.random()
    iterations = int(rng.integers(2, 4)) if style < 0.3 else 8
    squeeze = _squeeze(rng) if 0.3 <= style < 0.5 else np.eye(3)
    vertices, faces = _remeshed(vertices @ squeeze, faces, _draw_face_count(rng), _CAD_FEATURE_ANGLE, iterations)
    vertices = vertices @ np.linalg.inv(squeeze)
    if rng.random() < 0.4:
        vertices = jittered(rng, vertices, faces, float(rng.uniform(0.05, 0.2)))
    return family, vertices, faces


def _squeeze(rng: np.random.Generator) -> FloatArray:
    """A (3, 3) stretch along a coordinate axis; triangles made after it are long across that axis."""
    stretch = np.ones(3)
    stretch[int(rng.integers(3))] = rng.uniform(1.3, 2.0)
    return np.diag(stretch)


def jittered(rng: np.random.Generator, vertices: FloatArray, faces: FaceArray, amount: float) -> FloatArray:
    """Return vertices moved at random within their tangent plane, where no sharp edge is near.

    Args:
        rng: Draws the moves.
        vertices: (V, 3) float64.
        faces: (F, 3).
        amount: Standard deviation in mean edge lengths.

    Returns:
        (V, 3) float64; vertices whose faces' normals differ by more than 8 degrees stay, as do those that would
        spoil a triangle.

    Example:
        >>> import numpy as np
        >>> shape = make_shape(0, "smooth")
        >>> moved = jittered(np.random.default_rng(0), shape.vertices, shape.faces, 0.1)
        >>> moved.shape == shape.vertices.shape
        True
    """
    normals = vertex_normals(vertices, faces)
    flat = _flat_vertices(vertices, faces, normals, np.cos(np.radians(8.0)))
    step = rng.standard_normal(vertices.shape) * amount * mean_edge_length(vertices, faces)
    step -= normals * np.einsum("ij,ij->i", step, normals)[:, None]
    step[~flat] = 0.0
    for _ in range(4):
        moved = vertices + step
        bad = triangle_quality(moved, faces) < 0.35
        if not bad.any():
            break
        step[np.unique(faces[bad])] *= 0.3
    step[np.unique(faces[triangle_quality(vertices + step, faces) < 0.2])] = 0.0
    return np.asarray(vertices + step)


def _flat_vertices(
    vertices: FloatArray, faces: FaceArray, normals: FloatArray, min_cos: float
) -> npt.NDArray[np.bool_]:
    """Mark the vertices all of whose faces are within an angle of the vertex normal."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    flat = np.ones(len(vertices), dtype=bool)
    for slot in range(3):
        ids = faces[:, slot]
        flat[ids[np.einsum("ij,ij->i", unit, normals[ids]) < min_cos]] = False
    return flat


def _make_smooth(rng: np.random.Generator) -> tuple[str, FloatArray, FaceArray]:
    family, vertices, faces = smooth_body(rng)
    if len(faces) == 0:
        return family, vertices, faces
    vertices, faces = _remeshed(vertices, faces, _draw_face_count(rng), 180.0, 8)
    if rng.random() < 0.3:
        vertices = jittered(rng, vertices, faces, float(rng.uniform(0.05, 0.15)))
    return family, vertices, faces


def _make_feature(rng: np.random.Generator) -> tuple[str, FloatArray, FaceArray]:
    family, vertices, faces = smooth_body(rng)
    if len(faces) == 0:
        return family, vertices, faces
    n_faces = float(rng.uniform(0.4, 0.85)) * FACE_RANGE[1]
    edge_length = _edge_length_for(vertices, faces, n_faces)
    relief, vertices = add_relief(rng, vertices, faces, edge_length)
    vertices, faces = _remeshed(vertices, faces, n_faces, 180.0, 6)
    return f"{family}-{relief}", vertices, faces


_MAKERS: dict[ShapeKind, Callable[[np.random.Generator], tuple[str, FloatArray, FaceArray]]] = {
    "cad": _make_cad,
    "smooth": _make_smooth,
    "feature": _make_feature,
}
