"""Fine relief for smooth bodies: bumps, ridges, scales, wrinkles, grooves and engravings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from gcnd.data.noise import FaceArray, FloatArray, smoothed, vertex_normals
from gcnd.data.shapes_field import SmoothNoise

Relief = Callable[[np.random.Generator, FloatArray, float], FloatArray]

_MAX_HEIGHT = 0.018


def add_relief(
    rng: np.random.Generator,
    vertices: FloatArray,
    faces: FaceArray,
    edge_length: float,
    *,
    shortest: float = 5.0,
    steepest: float = 0.2,
) -> tuple[str, FloatArray]:
    """Return a fine mesh's vertices moved along their normals by one to four layers of relief.

    Each layer has a wavelength of `shortest` to 16 edge lengths of the mesh to be made, a height of 6 % of that
    wavelength to `steepest` times it and at most 0.018 mesh units, and covers everything or patches that fade out.

    Args:
        rng: Draws everything.
        vertices: (V, 3) float64, sampled at least twice as finely as `edge_length`.
        faces: (F, 3), outward.
        edge_length: The edge length that the final mesh will have, in mesh units.
        shortest: Smallest wavelength in edge lengths.
        steepest: Largest height in wavelengths.

    Returns:
        The names of the layers joined by ``+``, and (V, 3) float64 vertices.

    Example:
        >>> import numpy as np
        >>> from gcnd.data.shapes_organic import smooth_body
        >>> rng = np.random.default_rng(1)
        >>> _, v, f = smooth_body(rng)
        >>> add_relief(rng, v, f, 0.01)[1].shape == v.shape
        True
    """
    names = []
    moved = vertices
    for _ in range(int(rng.integers(1, 5))):
        name = list(RELIEFS)[int(rng.integers(len(RELIEFS)))]
        wavelength = edge_length * float(np.exp(rng.uniform(np.log(shortest), np.log(16.0))))
        height = min(wavelength * float(rng.uniform(0.06, steepest)), _MAX_HEIGHT)
        layer = RELIEFS[name](rng, vertices, wavelength)
        if rng.random() < 0.4:
            mask = SmoothNoise(rng, float(rng.uniform(0.25, 0.7)))(vertices)
            layer = layer * _fade(mask, -0.3, 0.5)
        moved = moved + height * layer[:, None] * vertex_normals(moved, faces)
        names.append(name)
    # Where relief stretches the mesh, its samples zigzag; one round takes that off and leaves the relief.
    moved = np.stack([smoothed(moved[:, axis], faces, 1) for axis in range(3)], axis=1)
    return "+".join(names), moved


def _fade(values: FloatArray, low: float, high: float) -> FloatArray:
    """Rise smoothly from 0 at `low` to 1 at `high`."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def _warped(rng: np.random.Generator, points: FloatArray, wavelength: float, amount: float) -> FloatArray:
    """Positions shifted by smooth noise, so that straight patterns meander."""
    shift = [SmoothNoise(rng, 6 * wavelength)(points) for _ in range(3)]
    return points + amount * wavelength * np.stack(shift, axis=1)


def _bumps(rng: np.random.Generator, points: FloatArray, wavelength: float) -> FloatArray:
    total = SmoothNoise(rng, wavelength)(points)
    for octave in range(1, int(rng.integers(1, 4))):
        total = total + 0.6**octave * SmoothNoise(rng, wavelength * 1.9**octave)(points)
    return np.asarray(0.5 * total)


def _ridges(rng: np.random.Generator, points: FloatArray, wavelength: float) -> FloatArray:
    """Creases where the noise changes sign, as in folds and bark."""
    noise = SmoothNoise(rng, 1.6 * wavelength)(points)
    return np.asarray(1.0 - np.sqrt(noise**2 + 0.05))


def _scales(rng: np.random.Generator, points: FloatArray, wavelength: float) -> FloatArray:
    """A dome around each of many evenly strewn points, with a seam in between."""
    centres = _strewn(rng, points, wavelength)
    distances = np.asarray(cKDTree(centres).query(points, k=2)[0])
    gap = (distances[:, 1] - distances[:, 0]) / wavelength
    dome = 1 - (distances[:, 0] / wavelength) ** 2
    seam = _fade(gap, 0.0, 0.45)
    return np.asarray((dome if rng.random() < 0.5 else 1.0) * seam)


def _strewn(rng: np.random.Generator, points: FloatArray, distance: float) -> FloatArray:
    """Some of the points, at least about 0.7 times `distance` apart."""
    order = rng.permutation(len(points))
    cells = np.floor(points[order] / (0.8 * distance)).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    candidates = points[order[np.sort(first)]]
    tree = cKDTree(candidates)
    dropped = np.zeros(len(candidates), dtype=bool)
    for i, j in sorted(tree.query_pairs(0.7 * distance)):
        if not dropped[i]:
            dropped[j] = True
    kept = candidates[~dropped]
    return kept if len(kept) > 1 else points[:2]


def _wrinkles(rng: np.random.Generator, points: FloatArray, wavelength: float) -> FloatArray:
    """Meandering waves."""
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    phase = _warped(rng, points, wavelength, float(rng.uniform(0.2, 0.8))) @ way * (2 * np.pi / wavelength)
    return np.asarray(0.5 * np.sin(phase))


def _strands(rng: np.random.Generator, points: FloatArray, wavelength: float) -> FloatArray:
    """Hair: sharp-bottomed grooves of two nearby wavelengths, flowing along a field."""
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    place = _warped(rng, points, 2 * wavelength, 0.5) @ way
    coarse = np.abs(np.sin(np.pi * place / (2.3 * wavelength)))
    fine = np.abs(np.sin(np.pi * place / wavelength + SmoothNoise(rng, 8 * wavelength)(points)))
    return np.asarray(0.6 * np.sqrt(coarse**2 + 0.05) + 0.4 * np.sqrt(fine**2 + 0.05))


def _engraving(rng: np.random.Generator, points: FloatArray, wavelength: float) -> FloatArray:
    """Flat islands with steep flanks, or lines cut along the contours of noise."""
    noise = SmoothNoise(rng, 2 * wavelength)(points)
    if rng.random() < 0.5:
        return _fade(noise, -0.35, 0.35)
    return np.asarray(_fade(np.abs(noise), 0.0, 0.6))


def _weave(rng: np.random.Generator, points: FloatArray, wavelength: float) -> FloatArray:
    """Crossing waves, as in cloth and knurling."""
    place = _warped(rng, points, wavelength, 0.5) * (2 * np.pi / wavelength)
    turn = rng.standard_normal((2, 3))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return np.asarray(0.35 * (np.sin(place @ turn[0]) + np.sin(place @ turn[1])))


RELIEFS: dict[str, Relief] = {
    "bumps": _bumps,
    "ridges": _ridges,
    "scales": _scales,
    "wrinkles": _wrinkles,
    "strands": _strands,
    "engraving": _engraving,
    "weave": _weave,
}
"""The kinds of relief by name."""
