"""Procedural training shapes: clean closed meshes of machine parts, smooth and detailed bodies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from manifold3d import Manifold

from gcnd.data.noise import FaceArray, FloatArray, vertex_normals
from gcnd.data.shapes_cad import cad_solid
from gcnd.data.shapes_cad_edged import edged_solid
from gcnd.data.shapes_decimate import decimated, subdivided_from_coarse
from gcnd.data.shapes_detail import add_relief
from gcnd.data.shapes_mesh import FACE_RANGE, edge_length_for, is_sound, normalised, subdivided
from gcnd.data.shapes_organic import lattice_knot, smooth_body
from gcnd.data.shapes_remesh import TriangleStyle, draw_style, remeshed
from gcnd.errors import ConfigError

ShapeKind = Literal["cad", "smooth", "feature", "edged"]
"""Machine parts, smooth bodies, and smooth bodies with fine relief, the paper's three groups; and machine parts whose
edges are chamfered, filleted or stepped."""

SHAPE_KINDS: tuple[ShapeKind, ...] = get_args(ShapeKind)

Made = tuple[str, FloatArray, FaceArray]
Draw = Callable[[np.random.Generator], tuple[str, Manifold]]

_CAD_FEATURE_ANGLE = 18.0
_MAX_ATTEMPTS = 40


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

    ``cad``: primitives and profiles joined and cut, sharp edges kept by the remeshing. ``edged``: extruded outlines
    with chamfers, fillets and steps, one triangle to a few wide. ``smooth``: implicit and
    parametric bodies. ``feature``: smooth bodies with relief of wavelengths from 2.5 to 16 edge lengths. Triangles are
    isotropic, graded or irregular; those of smooth and detailed bodies also thinned out by quadrics, subdivided from
    few, or split rectangles.

    Args:
        seed: Any integer >= 0; the same seed and kind give the same shape.
        kind: One of `SHAPE_KINDS`, or None to draw half ``cad`` and a quarter each ``smooth`` and ``feature``.

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
        made = _MAKERS[kind](rng)
        if made is not None:
            family, vertices, faces = made
            return Shape(f"{kind}-{family}-{seed}", kind, normalised(vertices), faces)
    raise RuntimeError(f"no sound {kind} shape from seed {seed} in {_MAX_ATTEMPTS} attempts")


def _draw_face_count(rng: np.random.Generator) -> float:
    """Even in the logarithm, away from the ends of the range, which remeshing misses by some percent."""
    return float(np.exp(rng.uniform(np.log(1.25 * FACE_RANGE[0]), np.log(0.85 * FACE_RANGE[1]))))


def _make_cad(rng: np.random.Generator, draw: Draw = cad_solid) -> Made | None:
    family, solid = draw(rng)
    style = draw_style(rng, irregular=0.6)
    if style.noise > 0 or style.curvature > 0:
        # Wanted lengths are set at vertices, and a plane has none inside.
        solid = solid.refine_to_length(0.1)
    mesh = solid.to_mesh64()
    vertices = np.ascontiguousarray(mesh.vert_properties[:, :3], dtype=np.float64)
    faces = np.ascontiguousarray(mesh.tri_verts, dtype=np.uint32)
    if len(faces) == 0:
        return None
    vertices, faces = remeshed(
        rng, vertices, faces, n_faces=_draw_face_count(rng), feature_angle=_CAD_FEATURE_ANGLE, style=style
    )
    return (family, vertices, faces) if is_sound(vertices, faces) else None


def _make_edged(rng: np.random.Generator) -> Made | None:
    return _make_cad(rng, edged_solid)


def _make_smooth(rng: np.random.Generator) -> Made | None:
    meshing = _SMOOTH_MESHINGS[int(rng.choice(len(_SMOOTH_MESHINGS), p=_SMOOTH_SHARES))]
    n_faces = _draw_face_count(rng)
    if meshing == "lattice":
        n_across = int(np.sqrt(n_faces / 2) / float(np.exp(rng.uniform(np.log(1.5), np.log(6.0)))))
        vertices, faces = lattice_knot(rng, round(n_faces / 2 / n_across), n_across)
        return ("lattice", vertices, faces) if is_sound(vertices, faces) else None
    family, vertices, faces = smooth_body(rng)
    if len(faces) == 0:
        return None
    vertices, faces = _meshed(rng, meshing, vertices, faces, n_faces)
    sound = is_sound(
        vertices, faces, sharp_angle=40.0, sharp_share=0.004, sliver_share=_SLIVER_SHARES[meshing]
    )
    return (f"{family}-{meshing}", vertices, faces) if sound else None


def _make_feature(rng: np.random.Generator) -> Made | None:
    meshing = _FEATURE_MESHINGS[int(rng.choice(len(_FEATURE_MESHINGS), p=_FEATURE_SHARES))]
    family, vertices, faces = smooth_body(rng)
    if len(faces) == 0:
        return None
    n_faces = float(rng.uniform(0.4, 0.75)) * FACE_RANGE[1]
    even = TriangleStyle(iterations=5)
    vertices, faces = remeshed(rng, vertices, faces, n_faces=n_faces, feature_angle=180.0, style=even)
    edge_length = edge_length_for(vertices, faces, n_faces)
    vertices, faces = subdivided(vertices, faces, vertex_normals(vertices, faces))
    # Quadrics keep detail that an even mesh of the same size would blur, so it may be finer and steeper.
    finest = (5.0, 0.2) if meshing == "remeshed" else tuple(rng.uniform([2.5, 0.2], [6.0, 0.5]).tolist())
    relief, vertices = add_relief(rng, vertices, faces, edge_length, shortest=finest[0], steepest=finest[1])
    vertices, faces = _meshed(rng, meshing, vertices, faces, n_faces)
    sharp = 0.02 if meshing == "remeshed" else 0.08
    sound = is_sound(
        vertices, faces, sharp_angle=70.0, sharp_share=sharp, sliver_share=_SLIVER_SHARES[meshing]
    )
    return (f"{family}-{meshing}-{relief}", vertices, faces) if sound else None


def _meshed(
    rng: np.random.Generator, meshing: str, vertices: FloatArray, faces: FaceArray, n_faces: float
) -> tuple[FloatArray, FaceArray]:
    """The surface of a fine mesh in about `n_faces` triangles, as one kind of program would leave them."""
    if meshing == "decimated":
        if len(faces) <= round(n_faces):
            vertices, faces = subdivided(vertices, faces, vertex_normals(vertices, faces))
        return decimated(vertices, faces, n_faces, greed=float(rng.uniform(4.0, 8.0)))
    if meshing == "subdivided":
        return subdivided_from_coarse(vertices, faces, n_faces, rounds=int(rng.integers(1, 3)))
    return remeshed(rng, vertices, faces, n_faces=n_faces, feature_angle=180.0, style=draw_style(rng))


_SMOOTH_MESHINGS = ("remeshed", "decimated", "subdivided", "lattice")
_SMOOTH_SHARES = (0.42, 0.32, 0.16, 0.1)
_FEATURE_MESHINGS = ("remeshed", "decimated", "subdivided")
_FEATURE_SHARES = (0.25, 0.6, 0.15)
_SLIVER_SHARES = {"remeshed": 0.002, "decimated": 0.02, "subdivided": 0.02}

_MAKERS: dict[ShapeKind, Callable[[np.random.Generator], Made | None]] = {
    "cad": _make_cad,
    "smooth": _make_smooth,
    "feature": _make_feature,
    "edged": _make_edged,
}
