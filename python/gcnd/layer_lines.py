"""Lines of a printer's layers: one wave through space that all of a surface has in its unevenness."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["LayerLines", "Unevenness", "layer_lines", "unevenness"]

Points = NDArray[np.float64]
Values = NDArray[np.float64]

WAVELENGTHS = (2.5, 9.0)
"""Of the waves looked for, mean edge lengths: vertices show no shorter ones, and shapes have many longer ones."""

_BOX = 32
"""Side of the boxes that a surface is looked at in, mean edge lengths: a layer's phase wanders little in one."""

_SAMPLES = 64
"""Of a box along each axis, half of them empty, so that waves between two whole numbers in a box are seen."""

_FEWEST_IN_BOX = 100
_MOST_BOXES = 64
_SEEN = 6.0
_CELL = 12
_FEWEST_IN_CELL = 20
_SECTORS = 6
_SMALLEST_SIDE = 0.03
_ACROSS = 0.8
_LARGEST_OFFSET = 3.0


class Unevenness(NamedTuple):
    """How far vertices lie from their surroundings.

    Attributes:
        offsets: n_i · (v_i − mean of the neighbours) of each vertex (V,), mesh units; 0 without a face.
        places: Mean of each vertex and its neighbours (V, 3). Noise that every vertex has of its own moves it by
            amounts that do not correlate with the offset; the vertex itself would tell of waves along the normals of
            planes, for it lies where its offset puts it.
        normals: Area-weighted unit normals (V, 3); 0 without a face.
    """

    offsets: Values
    places: Points
    normals: Points


class LayerLines(NamedTuple):
    """The strongest plane wave in the unevenness of a mesh.

    Attributes:
        share: Of the variance of the offsets that the wave explains, 0 to 1.
        contrast: Its power over the median of that of waves as long in all directions.
        reach: Share of the vertices in boxes of 32 mean edges where that wave is 6 times as strong as such a median.
        weakest_side: Energy of the wave in the walls that face in the direction with least of it, over the mean of all:
            near 0 if only some walls of a shape are ribbed.
        wavelength: Mean edge lengths.
    """

    share: float = 0.0
    contrast: float = 0.0
    reach: float = 0.0
    weakest_side: float = 0.0
    wavelength: float = 0.0


def unevenness(vertices: Points, faces: NDArray[np.uint32]) -> Unevenness:
    """Measures how far every vertex lies from its neighbours, along its area-weighted normal.

    Args:
        vertices: Positions (V, 3), mesh units, squares of which are numbers.
        faces: Vertex ids (F, 3).

    Returns:
        Offsets, mean places and normals.

    Example:
        >>> roof = np.array([[0.0, 0, 3], [1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
        >>> faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]], dtype=np.uint32)
        >>> float(unevenness(roof, faces).offsets[0])
        3.0
    """
    n_vertices = len(vertices)
    ids = faces.astype(np.int64)
    begin, end = ids.ravel(), np.roll(ids, -1, axis=1).ravel()
    counts = np.bincount(begin, minlength=n_vertices) + np.bincount(end, minlength=n_vertices)
    corners = vertices[ids]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offsets, places, normals = np.zeros(n_vertices), np.empty((n_vertices, 3)), np.empty((n_vertices, 3))
    for axis in range(3):
        ends = np.bincount(begin, vertices[end, axis], n_vertices)
        begins = np.bincount(end, vertices[begin, axis], n_vertices)
        normals[:, axis] = np.bincount(begin, np.repeat(face_normals[:, axis], 3), n_vertices)
        offsets += normals[:, axis] * (vertices[:, axis] - (ends + begins) / np.maximum(counts, 1))
        # Both faces at an edge count its ends, so that the vertex itself counts twice.
        places[:, axis] = (ends + begins + 2 * vertices[:, axis]) / (counts + 2)
    lengths = np.sqrt(np.square(normals).sum(axis=1))
    scale = np.divide(1.0, lengths, out=np.zeros(n_vertices), where=lengths > 0)
    return Unevenness(offsets * scale, places, normals * scale[:, None])


def layer_lines(found: Unevenness, edge: float) -> LayerLines:
    """Looks for a wave through space that explains the offsets of a surface's vertices.

    A printer's layers leave ridges where up · x is a multiple of their height, on walls of every direction alike. With
    F_b(k) = Σ h_i exp(−2πi k · p_i) over the vertices of box b, h offset without its mean in the box and p place,
    share(k) = 2 Σ_b |F_b(k)|² / Σ_b n_b Σ_i h_i²; the wave is the k that lies highest above the median of all
    directions.

    Args:
        found: Offsets, places and normals of the vertices. Offsets beyond 3 times the median are those of a shape's
            edges, and count as 0.
        edge: Mean edge length, mesh units.

    Returns:
        The strongest wave; zeros for a mesh of fewer than 100 vertices in every box. Of many boxes, an even sample.

    Choice: docs/choices.md#auto.
    """
    size = np.abs(found.offsets)
    offsets = np.where(size < _LARGEST_OFFSET * np.median(size), found.offsets, 0.0) if len(size) else size
    boxes = _boxes(found.places / edge, _BOX) if edge > 0 else None
    if boxes is None:
        return LayerLines()
    places = (found.places - found.places.min(axis=0)) / edge
    order = np.argsort(boxes, kind="stable")
    ends = np.cumsum(np.bincount(boxes))
    members = [ids for ids in np.split(order, ends[:-1]) if len(ids) >= _FEWEST_IN_BOX]
    members = [ids for ids in members[:: 1 + len(members) // _MOST_BOXES] if np.ptp(offsets[ids]) > 0]
    if not members:
        return LayerLines()
    waves, rings = _waves()
    powers = np.array([_power(places[ids], offsets[ids]) for ids in members])
    counts = np.array([len(ids) for ids in members])
    energies = np.array([len(ids) ** 2 * np.var(offsets[ids]) for ids in members])
    shares = 2 * powers.sum(axis=0) / energies.sum()
    usual = np.array(
        [np.median(shares[rings == ring]) if ring in rings else 0.0 for ring in range(rings.max() + 1)]
    )
    best = int(np.argmax(shares - usual[rings]))
    share, typical = float(shares[best] - usual[rings[best]]), float(usual[rings[best]])
    usual_in_box = np.median(powers[:, rings == rings[best]], axis=1)
    ids = np.concatenate(members)
    return LayerLines(
        share=share,
        contrast=float(shares[best]) / typical if typical > 0 else 0.0,
        reach=float(np.average(powers[:, best] > _SEEN * usual_in_box, weights=counts)),
        weakest_side=_weakest_side(places[ids], offsets[ids], found.normals[ids], waves[best]),
        wavelength=float(1 / np.linalg.norm(waves[best])),
    )


@cache
def _waves() -> tuple[Points, NDArray[np.int64]]:
    """Waves looked for (W, 3), in periods for each mean edge, and the ring of like wavelengths that each is in (W,)."""
    along, half = np.fft.fftfreq(_SAMPLES), np.fft.rfftfreq(_SAMPLES)
    waves = np.stack(np.meshgrid(along, along, half, indexing="ij"), axis=-1)[_is_looked_for()]
    return waves, np.round(np.linalg.norm(waves, axis=1) * _SAMPLES).astype(np.int64)


@cache
def _is_looked_for() -> NDArray[np.bool_]:
    along, half = np.fft.fftfreq(_SAMPLES), np.fft.rfftfreq(_SAMPLES)
    squares = along[:, None, None] ** 2 + along[:, None] ** 2 + half**2
    is_in: NDArray[np.bool_] = (squares >= WAVELENGTHS[1] ** -2) & (squares <= WAVELENGTHS[0] ** -2)
    return is_in


def _power(places: Points, offsets: Values) -> NDArray[np.float32]:
    """|F_b(k)|² of one box for every wave looked for (W,)."""
    from scipy.fft import rfftn

    sample = np.floor(places).astype(np.int64) % _BOX
    index = np.ravel_multi_index(tuple(sample.T), (_SAMPLES,) * 3)
    grid = np.bincount(index, offsets - offsets.mean(), _SAMPLES**3).astype(np.float32)
    power: NDArray[np.float32] = np.square(np.abs(rfftn(grid.reshape((_SAMPLES,) * 3))[_is_looked_for()]))
    return power


def _weakest_side(places: Points, offsets: Values, normals: Points, wave: Values) -> float:
    """Energy of a wave in the walls of the direction that has least of it, over the mean of all.

    Directions are six sectors around the wave. Faces across it, which show no lines, and sectors of less than 3 % of
    the vertices do not count.
    """
    towards = wave / np.linalg.norm(wave)
    right = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
    right /= np.linalg.norm(right)
    is_wall = np.abs(normals @ towards) < _ACROSS
    places, offsets, normals = places[is_wall], offsets[is_wall], normals[is_wall]
    turns = np.arctan2(normals @ np.cross(towards, right), normals @ right) / (2 * np.pi) + 0.5
    sectors = np.minimum((_SECTORS * turns).astype(np.int64), _SECTORS - 1)
    boxes = _boxes(places, _CELL) if len(places) else None
    if boxes is None:
        return 0.0
    cells = boxes * _SECTORS + sectors
    phases = 2 * np.pi * (places @ wave)
    cosine, sine = np.bincount(cells, offsets * np.cos(phases)), np.bincount(cells, offsets * np.sin(phases))
    counts = np.bincount(cells)
    is_full = counts >= _FEWEST_IN_CELL
    # What independent offsets would give on average is taken away.
    energies = (np.square(cosine) + np.square(sine) - np.bincount(cells, np.square(offsets)))[is_full]
    counts, sides = counts[is_full], np.flatnonzero(is_full) % _SECTORS
    n_on_side = np.bincount(sides, counts, _SECTORS)
    # Σ n · |F|² / n² over the cells of a side, over Σ n: the mean squared amplitude there.
    on_side = np.bincount(sides, energies / np.maximum(counts, 1), _SECTORS)
    is_large = n_on_side >= _SMALLEST_SIDE * max(n_on_side.sum(), 1)
    mean = float(on_side.sum()) / max(float(n_on_side.sum()), 1.0)
    if not mean > 0 or not is_large.any():
        return 0.0
    return max(float((on_side[is_large] / n_on_side[is_large]).min()), 0.0) / mean


def _boxes(places: Points, size: int) -> NDArray[np.int64] | None:
    """Number of the box that each place lies in (N,), empty boxes not counted; None if they lie too far apart."""
    boxes = np.floor((places - places.min(axis=0)) / size)
    n_boxes = boxes.max(axis=0) + 1
    if not np.prod(n_boxes) < 2**62:
        return None
    index = np.ravel_multi_index(tuple(boxes.astype(np.int64).T), tuple(n_boxes.astype(np.int64)))
    numbers: NDArray[np.int64] = np.unique(index, return_inverse=True)[1]
    return numbers
