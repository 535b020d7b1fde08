"""Procedural free-form bodies: smooth implicit and parametric surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial.transform import Rotation
from skimage.measure import label, marching_cubes

FloatArray = npt.NDArray[np.float64]
FaceArray = npt.NDArray[np.uint32]
Body = tuple[str, FloatArray, FaceArray]

GRID = 120
"""Grid points along the longest side of an implicit body."""


def smooth_body(rng: np.random.Generator) -> Body:
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
    name = names[int(rng.integers(len(names)))]
    vertices, faces = FAMILIES[name](rng)
    return name, vertices, faces


def iso_surface(
    field: Callable[[FloatArray], npt.NDArray[np.floating]], half: FloatArray
) -> tuple[FloatArray, FaceArray]:
    """Return the zero surface of a field that is negative inside, its largest piece, as triangles.

    The field is sampled on a grid over [-half, half] and its vertices are moved onto the zero surface of the cubic
    spline through the samples, so that normals show no trace of the grid.

    Args:
        field: (N, 3) float32 positions to (N,) values.
        half: (3,) half sides of the box; the field must be positive on its border.

    Returns:
        (V, 3) float64 vertices and (F, 3) uint32 faces, outward; empty if the field is nowhere negative.

    Example:
        >>> import numpy as np
        >>> v, f = iso_surface(lambda p: np.linalg.norm(p, axis=1) - 0.5, np.full(3, 0.6))
        >>> bool(abs(np.linalg.norm(v, axis=1) - 0.5).max() < 1e-4)
        True
    """
    step = 2 * float(np.max(half)) / (GRID - 1)
    shape = [int(np.ceil(2 * h / step)) + 3 for h in half]
    axes = [(np.arange(n) - 0.5 * (n - 1)) * step for n in shape]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
    values = np.asarray(field(points), dtype=np.float32).reshape(shape)
    _close_border(values, step)
    pieces = label(values < 0, connectivity=1)
    counts = np.bincount(pieces.reshape(-1))
    if len(counts) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint32)
    keep = int(np.argmax(counts[1:])) + 1
    values = np.where((values < 0) & (pieces != keep), np.abs(values), values)
    voids = label(values >= 0, connectivity=1)
    outside = voids[0, 0, 0]
    values = np.where((values >= 0) & (voids != outside), -np.abs(values) - 1e-6, values)
    grid_vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    grid_vertices = _onto_zero(values, grid_vertices.astype(np.float64))
    centre = 0.5 * (np.array(shape) - 1)
    return (grid_vertices - centre) * step, faces.astype(np.uint32)


def _close_border(values: npt.NDArray[np.float32], step: float) -> None:
    """Make a field positive on its border, so that its zero surface is closed."""
    for axis in range(3):
        for end in (0, -1):
            border = np.moveaxis(values, axis, 0)[end]
            np.maximum(border, step, out=border)


def _onto_zero(values: npt.NDArray[np.float32], points: FloatArray) -> FloatArray:
    """Move points along the spline's gradient onto its zero set; `points` in grid steps."""
    coefficients = ndimage.spline_filter(values.astype(np.float64), order=3)

    def at(p: FloatArray) -> FloatArray:
        return np.asarray(ndimage.map_coordinates(coefficients, p.T, order=3, prefilter=False, mode="nearest"))

    h = 0.05
    for _ in range(3):
        value = at(points)
        slopes = [(at(points + h * e) - at(points - h * e)) / (2 * h) for e in np.eye(3)]
        gradient = np.stack(slopes, axis=1)
        squared = np.maximum((gradient**2).sum(axis=1), 1e-12)
        move = -(value / squared)[:, None] * gradient
        length = np.linalg.norm(move, axis=1, keepdims=True)
        points = points + move * np.minimum(1.0, 0.3 / np.maximum(length, 1e-12))
    return points


class SmoothNoise:
    """Band-limited random field: filtered white noise on a periodic grid, standard deviation 1.

    Args:
        rng: Draws the field.
        wavelength: About the distance between maxima, in units of the points given later.

    Example:
        >>> import numpy as np
        >>> noise = SmoothNoise(np.random.default_rng(0), 0.3)
        >>> noise(np.zeros((2, 3))).shape
        (2,)
    """

    _SIZE = 32
    _CELLS_PER_WAVE = 4.0

    def __init__(self, rng: np.random.Generator, wavelength: float) -> None:
        white = rng.standard_normal((self._SIZE,) * 3)
        fine = ndimage.gaussian_filter(white, 0.25 * self._CELLS_PER_WAVE, mode="wrap")
        coarse = ndimage.gaussian_filter(white, 0.5 * self._CELLS_PER_WAVE, mode="wrap")
        band = fine - coarse
        self._coefficients = ndimage.spline_filter(band / band.std(), order=3, mode="grid-wrap")
        self._scale = self._CELLS_PER_WAVE / wavelength
        self._turn = Rotation.random(rng=rng).as_matrix()
        self._shift = rng.uniform(0, self._SIZE, 3)

    def __call__(self, points: npt.NDArray[np.floating]) -> FloatArray:
        """Return the field at (N, 3) points, (N,) float64."""
        cells = (np.asarray(points, np.float64) @ self._turn.T) * self._scale + self._shift
        values = ndimage.map_coordinates(self._coefficients, cells.T, order=3, mode="grid-wrap", prefilter=False)
        return np.asarray(values)


def smooth_union(fields: npt.NDArray[np.floating], blend: float) -> npt.NDArray[np.floating]:
    """Return the rounded minimum of (K, N) distances; `blend` is the radius of the rounding.

    Example:
        >>> import numpy as np
        >>> float(smooth_union(np.array([[1.0], [5.0]]), 0.1)[0])
        1.0
    """
    lowest = fields.min(axis=0)
    return np.asarray(lowest - blend * np.log(np.exp((lowest - fields) / blend).sum(axis=0)))


def _ellipsoids(rng: np.random.Generator) -> tuple[FloatArray, FaceArray]:
    """Balls and ellipsoids melted together."""
    n_balls = int(rng.integers(2, 9))
    centres = rng.uniform(-0.28, 0.28, (n_balls, 3))
    radii = rng.uniform(0.1, 0.25, (n_balls, 3))
    turns = Rotation.random(n_balls, rng=rng).as_matrix()
    blend = float(rng.uniform(0.015, 0.06))

    def field(points: FloatArray) -> npt.NDArray[np.floating]:
        distances = []
        for centre, radius, turn in zip(centres, radii, turns, strict=True):
            local = (points - centre) @ turn.T
            distances.append((np.linalg.norm(local / radius, axis=1) - 1) * radius.min())
        return smooth_union(np.stack(distances), blend)

    return iso_surface(field, np.full(3, 0.56))


def _figure(rng: np.random.Generator) -> tuple[FloatArray, FaceArray]:
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

    def field(points: FloatArray) -> npt.NDArray[np.floating]:
        rounded = smooth_union(np.stack([_rod(points, *rod) for rod in rods]), blend)
        return rounded + bump * noise(points)

    return iso_surface(field, np.full(3, 0.52))


def _rod(points: FloatArray, a: FloatArray, b: FloatArray, ra: float, rb: float) -> npt.NDArray[np.floating]:
    """Distance to a segment less a radius that runs from `ra` to `rb`."""
    along = (b - a).astype(np.float32)
    share = np.clip((points - a.astype(np.float32)) @ along / max(float(along @ along), 1e-9), 0, 1)
    gap = points - (a.astype(np.float32) + share[:, None] * along)
    return np.asarray(np.linalg.norm(gap, axis=1) - (ra + (rb - ra) * share))


def _boulder(rng: np.random.Generator) -> tuple[FloatArray, FaceArray]:
    """A superellipsoid pushed in and out by noise of a few wavelengths."""
    half = rng.uniform(0.22, 0.45, 3)
    power = float(rng.uniform(2.0, 5.0))
    waves = [(SmoothNoise(rng, 0.5 * 0.6**i), 0.05 * 0.6**i * float(rng.uniform(0.3, 1.2))) for i in range(3)]

    def field(points: FloatArray) -> npt.NDArray[np.floating]:
        radius = (np.abs(points / half.astype(np.float32)) ** power).sum(axis=1) ** (1 / power)
        value = (radius - 1) * half.min()
        near = np.abs(value) < 0.25
        for noise, amplitude in waves:
            value[near] += amplitude * noise(points[near])
        return np.asarray(value)

    return iso_surface(field, half + 0.14)


def _sponge(rng: np.random.Generator) -> tuple[FloatArray, FaceArray]:
    """Filtered noise inside a ball: handles and hollows."""
    noise, level = SmoothNoise(rng, float(rng.uniform(0.4, 0.6))), float(rng.uniform(0.1, 0.6))

    def field(points: FloatArray) -> npt.NDArray[np.floating]:
        shell = np.linalg.norm(points, axis=1) - 0.45
        near = shell < 0.1
        value = np.array(shell, dtype=np.float64)
        inner = 0.1 * (noise(points[near]) - level)
        both = np.stack([-shell[near], -inner])
        value[near] = -smooth_union(both, 0.02)
        return value

    return iso_surface(field, np.full(3, 0.5))


def tube_mesh(centres: FloatArray, radii: FloatArray) -> tuple[FloatArray, FaceArray]:
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
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    i2, j2 = (i + 1) % n, (j + 1) % m
    a, b, c, d = (x.reshape(-1) for x in (i * m + j, i2 * m + j, i2 * m + j2, i * m + j2))
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)])
    return vertices.reshape(-1, 3), faces.astype(np.uint32)


def _knot(rng: np.random.Generator) -> tuple[FloatArray, FaceArray]:
    """A torus or torus knot whose cross section swells and twists."""
    p, q = [(1, 0), (2, 3), (3, 2), (2, 5)][int(rng.integers(4))]
    s = np.linspace(0, 2 * np.pi, 700, endpoint=False)
    around = 0.3 + 0.11 * np.cos(q * s) * (q > 0)
    lift = 0.11 * np.sin(q * s) * (q > 0) + 0.05 * np.cos(2 * s + rng.uniform(0, 6)) * (q == 0)
    centres = np.stack([around * np.cos(p * s), around * np.sin(p * s), lift], axis=1)
    base = float(rng.uniform(0.05, 0.075)) if q else float(rng.uniform(0.08, 0.16))
    t = np.linspace(0, 2 * np.pi, 160, endpoint=False)
    lobes, turns = int(rng.integers(2, 6)), int(rng.integers(0, 9))
    depth = float(rng.uniform(0.0, 0.18))
    swell = 1 + 0.15 * np.cos(int(rng.integers(1, 7)) * s)[:, None] * float(rng.uniform(0, 1))
    return tube_mesh(centres, base * swell * (1 + depth * np.cos(lobes * t[None] + turns * s[:, None])))


def _superquadric(rng: np.random.Generator) -> tuple[FloatArray, FaceArray]:
    """A superellipsoid, from pillow to rounded box, bent and twisted."""
    half = rng.uniform(0.18, 0.4, 3)
    e1, e2 = (float(x) for x in rng.uniform(2.0, 7.0, 2))
    twist = float(rng.uniform(-2.5, 2.5)) if rng.random() < 0.5 else 0.0

    def field(points: FloatArray) -> npt.NDArray[np.floating]:
        angle = twist * points[:, 2]
        c, s = np.cos(angle), np.sin(angle)
        x = np.abs(c * points[:, 0] - s * points[:, 1]) / half[0]
        y = np.abs(s * points[:, 0] + c * points[:, 1]) / half[1]
        flat = (x**e1 + y**e1) ** (1 / e1)
        whole = (flat**e2 + np.abs(points[:, 2] / half[2]) ** e2) ** (1 / e2)
        return np.asarray((whole - 1) * half.min())

    side = float(np.hypot(half[0], half[1])) + 0.04
    return iso_surface(field, np.array([side, side, half[2] + 0.04]))


FAMILIES: dict[str, Callable[[np.random.Generator], tuple[FloatArray, FaceArray]]] = {
    "ellipsoids": _ellipsoids,
    "figure": _figure,
    "boulder": _boulder,
    "sponge": _sponge,
    "knot": _knot,
    "superquadric": _superquadric,
}
"""The families of smooth bodies by name."""
