"""Procedural free-form bodies: smooth implicit and parametric surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from gcnd.data.noise import FaceArray, FloatArray
from gcnd.data.shapes_field import SmoothNoise, iso_surface, rod, smooth_union

Mesh = tuple[FloatArray, FaceArray]


def smooth_body(rng: np.random.Generator) -> tuple[str, FloatArray, FaceArray]:
    """Return a random smooth closed surface, finely and irregularly triangulated.

    Args:
        rng: Draws everything; the same state gives the same body.

    Returns:
        The family's name, (V, 3) float64 vertices about 1 across, (F, 3) uint32 faces, outward.

    Example:
        >>> import numpy as np
        >>> name, vertices, faces = smooth_body(np.random.default_rng(0))
        >>> vertices.shape[1], faces.dtype.name
        (3, 'uint32')
    """
    names = list(FAMILIES)
    name = names[int(rng.choice(len(names), p=_SHARES))]
    vertices, faces = FAMILIES[name](rng)
    return name, vertices, faces


def _ellipsoids(rng: np.random.Generator) -> Mesh:
    """Balls and ellipsoids melted together."""
    n_balls = int(rng.integers(2, 9))
    centres = rng.uniform(-0.28, 0.28, (n_balls, 3))
    radii = rng.uniform(0.1, 0.25, (n_balls, 3))
    turns = Rotation.from_quat(rng.standard_normal((n_balls, 4))).as_matrix()
    blend = float(rng.uniform(0.015, 0.06))

    def field(points: npt.NDArray[np.float32]) -> npt.NDArray[np.floating]:
        distances = []
        for centre, radius, turn in zip(centres, radii, turns, strict=True):
            local = (points - centre) @ turn.T
            distances.append((np.linalg.norm(local / radius, axis=1) - 1) * radius.min())
        return smooth_union(np.stack(distances), blend)

    return iso_surface(field, np.full(3, 0.56))


def _figure(rng: np.random.Generator) -> Mesh:
    """A trunk with limbs and a head, of tapered rods melted together, like a small statue."""
    trunk = [np.array([0.0, 0.0, -0.25]), np.array([0.0, 0.0, 0.15]) + rng.uniform(-0.05, 0.05, 3)]
    rods = [(trunk[0], trunk[1], float(rng.uniform(0.1, 0.16)), float(rng.uniform(0.08, 0.14)))]
    head = trunk[1] + np.array([0.0, 0.0, float(rng.uniform(0.12, 0.18))])
    rods.append((head, head + rng.uniform(-0.03, 0.05, 3), float(rng.uniform(0.08, 0.12)), 0.07))
    for _ in range(int(rng.integers(2, 7))):
        start = trunk[0] + (trunk[1] - trunk[0]) * rng.uniform(0, 1)
        radius = float(rng.uniform(0.03, 0.07))
        for _ in range(int(rng.integers(1, 4))):
            end = np.clip(start + rng.normal(0, 0.14, 3), -0.42, 0.42)
            thinner = radius * float(rng.uniform(0.6, 1.0))
            rods.append((start, end, radius, thinner))
            start, radius = end, max(thinner, 0.022)
    blend = float(rng.uniform(0.008, 0.035))
    noise, bump = SmoothNoise(rng, float(rng.uniform(0.15, 0.3))), float(rng.uniform(0.0, 0.008))

    def field(points: npt.NDArray[np.float32]) -> npt.NDArray[np.floating]:
        rounded = smooth_union(np.stack([rod(points, *bone) for bone in rods]), blend)
        return rounded + bump * noise(points)

    return iso_surface(field, np.full(3, 0.52))


def _head(rng: np.random.Generator) -> Mesh:
    """A head or mask: skull, brow, nose, lips, eyes in their sockets, ears and neck, alike on both sides."""
    skull = rng.uniform([0.17, 0.2, 0.24], [0.24, 0.27, 0.34])
    blend = float(rng.uniform(0.01, 0.03))
    face = np.array([0.0, -0.92 * skull[1], 0.0])
    eye_x, eye_z = 0.4 * skull[0], float(rng.uniform(0.05, 0.3)) * skull[2]
    nose, ear = float(rng.uniform(0.05, 0.11)), float(rng.uniform(0.04, 0.11))
    eye = float(rng.uniform(0.025, 0.04))
    chin = float(rng.uniform(0.05, 0.1))
    socket = np.array([eye_x, -0.93 * skull[1], eye_z])
    ear_top = np.array([skull[0] + 0.6 * ear, 0.02, eye_z + ear * float(rng.uniform(0.5, 2.5))])

    def at(base: FloatArray, x: float, y: float, z: float) -> FloatArray:
        return np.asarray(base + np.array([x, y, z]))

    rods = [
        (at(face, 0, 0.01, eye_z), at(face, 0, -nose, eye_z - 0.12), 0.018, 0.03),
        (at(face, 0, -0.005, -0.19), at(face, 0, 0.02, -0.21), chin, chin),
        (at(face, -0.05, 0.0, -0.14), at(face, 0.05, 0.0, -0.14), 0.014, 0.014),
        (np.array([0.0, 0.05, -skull[2]]), np.array([0.0, 0.1, -0.5]), 0.11, 0.14),
        (at(socket, -0.05, -0.01, eye + 0.015), at(socket, 0.05, 0.02, eye + 0.015), 0.017, 0.012),
        (np.array([skull[0] - 0.01, 0.02, eye_z - 0.04]), ear_top, 0.035, 0.018),
    ]
    lumps, lump = SmoothNoise(rng, 0.25), float(rng.uniform(0.0, 0.008))

    def field(points: npt.NDArray[np.float32]) -> npt.NDArray[np.floating]:
        mirrored = np.array(points, np.float64)
        mirrored[:, 0] = np.abs(mirrored[:, 0])
        parts = [(np.linalg.norm(points / skull, axis=1) - 1) * skull.min()]
        parts += [rod(mirrored, *bone) for bone in rods]
        solid = smooth_union(np.stack(parts), blend)
        hollow = np.linalg.norm(mirrored - socket, axis=1) - 1.35 * eye
        solid = -smooth_union(np.stack([-solid, hollow]), 0.5 * blend)
        ball = np.linalg.norm(mirrored - socket, axis=1) - eye
        return smooth_union(np.stack([solid, ball]), 0.004) + lump * lumps(points)

    return iso_surface(field, np.array([0.42, 0.42, 0.5]))


def _boulder(rng: np.random.Generator) -> Mesh:
    """A superellipsoid pushed in and out by noise of a few wavelengths."""
    half = rng.uniform(0.22, 0.45, 3)
    power = float(rng.uniform(2.0, 5.0))
    waves = [(SmoothNoise(rng, 0.5 * 0.6**i), 0.05 * 0.6**i * float(rng.uniform(0.2, 1.0))) for i in range(3)]

    def field(points: npt.NDArray[np.float32]) -> npt.NDArray[np.floating]:
        radius = (np.abs(points / half) ** power).sum(axis=1) ** (1 / power)
        value = np.array((radius - 1) * half.min())
        for noise, amplitude in waves:
            value += amplitude * noise(points)
        return value

    return iso_surface(field, half + 0.14)


def _sponge(rng: np.random.Generator) -> Mesh:
    """Filtered noise inside a ball: handles and hollows."""
    noise, level = SmoothNoise(rng, float(rng.uniform(0.5, 0.75))), float(rng.uniform(0.3, 0.8))

    def field(points: npt.NDArray[np.float32]) -> npt.NDArray[np.floating]:
        shell = np.linalg.norm(points, axis=1) - 0.44
        inner = 0.12 * (noise(points) - level)
        return -smooth_union(np.stack([-shell, -inner]), 0.03)

    return iso_surface(field, np.full(3, 0.5))


def tube_mesh(centres: FloatArray, radii: FloatArray) -> Mesh:
    """Return a closed tube around a closed curve.

    Args:
        centres: (N, 3), the curve, first point not repeated.
        radii: (N, M), distance from the curve for M directions around it.

    Returns:
        (N * M, 3) vertices and (2 N M, 3) uint32 faces, outward.

    Example:
        >>> import numpy as np
        >>> angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        >>> ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        >>> tube_mesh(ring, np.full((12, 6), 0.2))[1].shape
        (144, 3)
    """
    n, m = radii.shape
    tangent = np.roll(centres, -1, axis=0) - np.roll(centres, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    first = np.empty_like(centres)
    first[0] = np.cross(tangent[0], np.eye(3)[int(np.argmin(np.abs(tangent[0])))])
    for i in range(1, n):
        first[i] = first[i - 1] - tangent[i] * (first[i - 1] @ tangent[i])
        first[i] /= np.linalg.norm(first[i])
    first[0] /= np.linalg.norm(first[0])
    second = np.cross(tangent, first)
    # The frame carried round comes back turned by some angle; undo it evenly along the curve.
    lack = np.arctan2(first[0] @ second[-1], first[0] @ first[-1])
    turn = np.linspace(0, lack, n)[:, None] + np.linspace(0, 2 * np.pi, m, endpoint=False)
    ring = np.cos(turn)[..., None] * first[:, None] + np.sin(turn)[..., None] * second[:, None]
    vertices = centres[:, None] + radii[..., None] * ring
    row, column = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    row2, column2 = (row + 1) % n, (column + 1) % m
    corners = (row * m + column, row2 * m + column, row2 * m + column2, row * m + column2)
    a, b, c, d = (corner.reshape(-1) for corner in corners)
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)])
    return vertices.reshape(-1, 3), faces.astype(np.uint32)


def lattice_knot(rng: np.random.Generator, n_around: int, n_across: int) -> Mesh:
    """Return a torus or torus knot whose cross section swells and twists, as a lattice of split rectangles.

    Args:
        rng: Draws the knot.
        n_around: Rings along the knot.
        n_across: Points in a ring.

    Returns:
        (n_around * n_across, 3) vertices and twice as many faces.

    Example:
        >>> import numpy as np
        >>> lattice_knot(np.random.default_rng(0), 60, 20)[1].shape
        (2400, 3)
    """
    p, q = [(1, 0), (2, 3), (3, 2), (2, 5)][int(rng.integers(4))]
    s = np.linspace(0, 2 * np.pi, n_around, endpoint=False)
    around = 0.3 + 0.11 * np.cos(q * s) * (q > 0)
    lift = 0.11 * np.sin(q * s) * (q > 0) + 0.05 * np.cos(2 * s + rng.uniform(0, 6)) * (q == 0)
    centres = np.stack([around * np.cos(p * s), around * np.sin(p * s), lift], axis=1)
    base = float(rng.uniform(0.05, 0.075)) if q else float(rng.uniform(0.08, 0.16))
    t = np.linspace(0, 2 * np.pi, n_across, endpoint=False)
    lobes, turns = int(rng.integers(2, 6)), int(rng.integers(0, 9))
    depth = float(rng.uniform(0.0, 0.18))
    swell = 1 + 0.15 * np.cos(int(rng.integers(1, 7)) * s)[:, None] * float(rng.uniform(0, 1))
    return tube_mesh(centres, base * swell * (1 + depth * np.cos(lobes * t[None] + turns * s[:, None])))


def _knot(rng: np.random.Generator) -> Mesh:
    """A torus or torus knot."""
    return lattice_knot(rng, 700, 160)


def _superquadric(rng: np.random.Generator) -> Mesh:
    """A superellipsoid, from pillow to rounded box, bent and twisted."""
    half = rng.uniform(0.12, 0.42, 3)
    e1, e2 = (float(x) for x in rng.uniform(2.0, 8.0, 2))
    twist = float(rng.uniform(-2.5, 2.5)) if rng.random() < 0.5 else 0.0

    def field(points: npt.NDArray[np.float32]) -> npt.NDArray[np.floating]:
        angle = twist * points[:, 2]
        c, s = np.cos(angle), np.sin(angle)
        x = np.abs(c * points[:, 0] - s * points[:, 1]) / half[0]
        y = np.abs(s * points[:, 0] + c * points[:, 1]) / half[1]
        flat = (x**e1 + y**e1) ** (1 / e1)
        whole = (flat**e2 + np.abs(points[:, 2] / half[2]) ** e2) ** (1 / e2)
        return np.asarray((whole - 1) * half.min())

    side = float(np.hypot(half[0], half[1])) + 0.04
    return iso_surface(field, np.array([side, side, half[2] + 0.04]))


FAMILIES: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "ellipsoids": _ellipsoids,
    "figure": _figure,
    "head": _head,
    "boulder": _boulder,
    "sponge": _sponge,
    "knot": _knot,
    "superquadric": _superquadric,
}
"""The families of smooth bodies by name."""

_SHARES = np.array([0.17, 0.2, 0.2, 0.16, 0.09, 0.1, 0.08])
