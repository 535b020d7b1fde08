"""Scalar fields in space: smooth noise, melted distances, and their zero surfaces as triangles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial.transform import Rotation
from skimage.measure import marching_cubes

from gcnd.data.noise import FaceArray, FloatArray

Field = Callable[[npt.NDArray[np.float32]], npt.NDArray[np.floating]]
"""(N, 3) float32 positions to (N,) values, negative inside, changing by at most about 2 per unit length."""

GRID = 120
"""Grid points along the longest side of an implicit body."""

_COARSE = 3
_BAND = 5.5
"""Half width, in grid steps, of the shell around the surface in which the field itself is evaluated."""


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
        quaternion = rng.standard_normal(4)
        self._turn = Rotation.from_quat(quaternion / np.linalg.norm(quaternion)).as_matrix()
        self._shift = rng.uniform(0, self._SIZE, 3)

    def __call__(self, points: npt.NDArray[np.floating]) -> FloatArray:
        """Return the field at (N, 3) points, (N,) float64."""
        cells = (np.asarray(points, np.float64) @ self._turn.T) * self._scale + self._shift
        values = ndimage.map_coordinates(
            self._coefficients, cells.T, order=3, mode="grid-wrap", prefilter=False
        )
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


def rod(
    points: npt.NDArray[np.floating], a: FloatArray, b: FloatArray, ra: float, rb: float
) -> npt.NDArray[np.floating]:
    """Return the distance of (N, 3) points to the segment a-b less a radius that runs from `ra` to `rb`,
    or as far towards `rb` as half the segment's length allows.

    Example:
        >>> import numpy as np
        >>> float(rod(np.array([[0.0, 2.0, 0.0]]), np.zeros(3), np.array([1.0, 0, 0]), 0.5, 0.2)[0])
        1.5
    """
    along = b - a
    # A cone steeper than this has no smooth side.
    rb = float(np.clip(rb, ra - 0.5 * np.linalg.norm(along), ra + 0.5 * np.linalg.norm(along)))
    share = np.clip((points - a) @ along / max(float(along @ along), 1e-12), 0, 1)
    gap = np.linalg.norm(points - (a + share[:, None] * along), axis=1)
    return np.asarray(gap - (ra + (rb - ra) * share))


def iso_surface(field: Field, half: FloatArray) -> tuple[FloatArray, FaceArray]:
    """Return the zero surface of a field, its largest piece without inner voids, as triangles.

    The field is sampled on a grid over [-half, half] and vertices are moved onto the zero surface of the cubic
    spline through the samples, so that normals show no trace of the grid.

    Args:
        field: Negative inside.
        half: (3,) half sides of the box; where the body would leave it, it is cut off.

    Returns:
        (V, 3) float64 vertices and (F, 3) uint32 faces, outward; empty if the field is nowhere negative.

    Example:
        >>> import numpy as np
        >>> v, f = iso_surface(lambda p: np.linalg.norm(p, axis=1) - 0.5, np.full(3, 0.6))
        >>> bool(abs(np.linalg.norm(v, axis=1) - 0.5).max() < 1e-4)
        True
    """
    step = 2 * float(np.max(half)) / (GRID - 1)
    shape = tuple(int(_COARSE * np.ceil((2 * h / step + 3) / _COARSE)) + 1 for h in half)
    values = _single_body(_sampled(field, shape, step), step)
    if not (values < 0).any():
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint32)
    vertices, faces, _, _ = marching_cubes(  # type: ignore[no-untyped-call]
        values, 0.0, gradient_direction="descent", allow_degenerate=False
    )
    on_surface = _onto_zero(values, vertices.astype(np.float64))
    return (on_surface - 0.5 * (np.array(shape) - 1)) * step, np.ascontiguousarray(faces, dtype=np.uint32)


def _sampled(field: Field, shape: tuple[int, ...], step: float) -> npt.NDArray[np.float32]:
    """The field on a grid around the origin: evaluated near its zero surface, interpolated elsewhere."""

    def evaluate(indices: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
        return field(((indices - 0.5 * (np.array(shape) - 1)) * step).astype(np.float32))

    coarse_shape = [(n - 1) // _COARSE + 1 for n in shape]
    coarse = np.stack(np.meshgrid(*(np.arange(n) * _COARSE for n in coarse_shape), indexing="ij"), axis=-1)
    known = evaluate(coarse.reshape(-1, 3).astype(np.float64)).reshape(coarse_shape).astype(np.float32)
    values = np.asarray(
        ndimage.zoom(known, [n / m for n, m in zip(shape, coarse_shape, strict=True)], order=1)
    )
    near = np.argwhere(np.abs(values) < _BAND * step)
    values[tuple(near.T)] = evaluate(near.astype(np.float64))
    for axis in range(3):
        for end in (0, -1):
            border = np.moveaxis(values, axis, 0)[end]
            np.maximum(border, step, out=border)
    return values


def _single_body(values: npt.NDArray[np.float32], step: float) -> npt.NDArray[np.float32]:
    """Keep the largest connected inside and the outside that reaches the border; flip the sign of the rest."""
    pieces = ndimage.label(values < 0)[0]
    counts = np.bincount(pieces.reshape(-1))
    if len(counts) > 2:
        keep = int(np.argmax(counts[1:])) + 1
        values = np.where((values < 0) & (pieces != keep), 0.2 * step, values)
    voids = ndimage.label(values >= 0)[0]
    return np.where((values >= 0) & (voids != voids[0, 0, 0]), np.float32(-0.2 * step), values)


def _onto_zero(values: npt.NDArray[np.float32], points: FloatArray) -> FloatArray:
    """Move points along the spline's gradient onto its zero set; `points` in grid steps."""
    coefficients = ndimage.spline_filter(values.astype(np.float64), order=3)

    def at(p: FloatArray) -> FloatArray:
        return np.asarray(
            ndimage.map_coordinates(coefficients, p.T, order=3, prefilter=False, mode="nearest")
        )

    h = 0.05
    slopes = [(at(points + h * e) - at(points - h * e)) / (2 * h) for e in np.eye(3)]
    gradient = np.stack(slopes, axis=1)
    gradient /= np.maximum((gradient**2).sum(axis=1, keepdims=True), 1e-12)
    for _ in range(2):
        move = -at(points)[:, None] * gradient
        length = np.linalg.norm(move, axis=1, keepdims=True)
        points = points + move * np.minimum(1.0, 0.3 / np.maximum(length, 1e-12))
    return points
