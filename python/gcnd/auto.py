"""Which weights suit a mesh: signs of its scanner, read from the mesh itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.layer_lines import layer_lines, unevenness

__all__ = ["AUTO", "CANDIDATES", "Choice", "Signs", "choose_preset", "read_signs"]

Points = NDArray[np.float64]
Faces = NDArray[np.uint32]

AUTO = "auto"
"""The preset that stands for one of `CANDIDATES`, chosen for each mesh."""

CANDIDATES = ("default", "scan")

CLEAN = 0.01
"""Noise in mean edge lengths under which a mesh counts as clean, and no scan."""

PIXEL_SHARE = 0.4
"""From here on a mesh counts as one frame of a camera: frames have 0.52 and more, other meshes up to 0.22."""

MILD_FRAME = 0.03
"""Noise in mean edge lengths under which a frame is better than a Kinect's, and `default` keeps more of its detail."""

MILD_WHITE_FRAME = 0.095
"""The same where neighbours err apart: a Kinect's noise is shared by neighbours, or larger than that."""

VOXEL_SHARE = 0.5
"""From here on a mesh counts as extracted from voxels: those have 0.78 and more, other meshes up to 0.08.

Grids of quads along the axes have as much, but even triangles."""

AREA_RATIO = 3.0
"""Surfaces cut voxels into large and small faces: 3.8 and more."""

LINE_SHARE = 0.05
"""From here on, with the three below, a mesh counts as printed: others that meet the three have up to 0.042."""

LINE_CONTRAST = 15.0
"""A margin for detail that runs in many directions: no mesh tried met the other three without it."""

LINE_REACH = 0.75
"""Detail on a part of a body reaches less far."""

LINE_WEAKEST_SIDE = 0.3
"""Ribs are on some of the walls of a machine part: 0 to 0.27."""

_AREA_TOLERANCE = 0.25
_ANGLE_TOLERANCE = 0.25
_FITS = 6
_LATTICE_STEP = 1e-3
_FEWEST_ON_PLANE = 20
_MOST_SAMPLED = 400_000


@dataclass(frozen=True)
class Signs:
    """What a mesh tells of how it was made.

    Attributes:
        level: Noise along the normals in mean edge lengths, see `gcnd.report.noise_level`.
        correlation: Of neighbouring vertices' offsets from their surroundings: about −0.2 for noise that every vertex
            has of its own, up to 1 for what is smooth at the size of an edge.
        pixel_share: Share of faces whose area, seen from one direction, is the same within a quarter: halves of a
            camera's pixels.
        voxel_share: Share of vertices with just two coordinates that many others have too, as where a surface crosses
            the edges of voxels.
        area_ratio: The 90th percentile of the areas of faces over the 10th.
        line_share: Share of the variance of vertices' offsets that one plane wave through space explains, as layers of
            a print make it; this and the next see `gcnd.layer_lines.LayerLines`.
        line_contrast: Power of that wave over that of waves as long in other directions.
        line_reach: Share of the vertices in boxes where it stands out.
        line_weakest_side: Its energy in walls of the direction that has least of it, over the mean.
        line_wavelength: Its length in mean edges; 0 where none was looked for.
    """

    level: float
    correlation: float
    pixel_share: float
    voxel_share: float
    area_ratio: float
    line_share: float = 0.0
    line_contrast: float = 0.0
    line_reach: float = 0.0
    line_weakest_side: float = 0.0
    line_wavelength: float = 0.0

    @property
    def has_lines(self) -> bool:
        """Whether lines as those of a printer's layers are seen on all of the mesh."""
        return (
            self.line_share >= LINE_SHARE
            and self.line_contrast >= LINE_CONTRAST
            and self.line_reach >= LINE_REACH
            and self.line_weakest_side >= LINE_WEAKEST_SIDE
        )

    def described(self) -> dict[str, float]:
        """Returns the signs as JSON-ready values."""
        return {name: round(float(value), 4) for name, value in asdict(self).items()}


class Choice(NamedTuple):
    """A preset, and why it was chosen, in a sentence without a full stop."""

    preset: str
    why: str

    def described(self, signs: Signs) -> dict[str, Any]:
        """Returns the choice as JSON-ready values."""
        return {"preset": self.preset, "why": self.why, "signs": signs.described()}


def choose_preset(signs: Signs) -> Choice:
    """Chooses between the weights for noise of each vertex's own and those for scanners.

    Args:
        signs: Of the mesh.

    Returns:
        The preset and the reason.

    Choice: docs/choices.md#auto.

    Example:
        >>> choose_preset(Signs(level=0.2, correlation=-0.2, pixel_share=0.01, voxel_share=0.0, area_ratio=2)).preset
        'default'
        >>> choose_preset(Signs(level=0.2, correlation=0.1, pixel_share=0.9, voxel_share=0.0, area_ratio=2))
        Choice(preset='scan', why="90 % of the faces are halves of a camera's pixels; noise 0.20 mean edges")
    """
    noise = f"noise {signs.level:.2f} mean edges"
    if signs.level < CLEAN:
        return Choice("default", f"it is nearly clean; {noise}")
    if signs.pixel_share >= PIXEL_SHARE:
        pixels = f"{100 * signs.pixel_share:.0f} % of the faces are halves of a camera's pixels"
        if signs.level < (MILD_WHITE_FRAME if signs.correlation < 0 else MILD_FRAME):
            return Choice("default", f"{pixels}, but a depth camera's noise is larger or wider; {noise}")
        return Choice("scan", f"{pixels}; {noise}")
    if signs.voxel_share >= VOXEL_SHARE and signs.area_ratio >= AREA_RATIO:
        vertices = f"{100 * signs.voxel_share:.0f} % of the vertices"
        return Choice("scan", f"{vertices} lie on the edges of voxels; {noise}")
    if signs.has_lines:
        lines = f"lines every {signs.line_wavelength:.1f} mean edges, as a printer's layers leave them"
        return Choice("scan", f"{lines}, are {100 * signs.line_share:.0f} % of its unevenness; {noise}")
    return Choice(
        "default", f"neither a camera's pixels nor voxels nor a printer's layers are seen in it; {noise}"
    )


def read_signs(
    topology: _geom.Topology,
    vertices: Points,
    faces: Faces,
    *,
    roughness: NDArray[np.float64] | None = None,
    ask: Callable[[], None] = lambda: None,
) -> Signs:
    """Reads the signs of a mesh.

    Args:
        topology: Adjacency of the mesh.
        vertices: Positions (V, 3), mesh units, each once: those of a `Start`, for one far off would hide the others.
        faces: Vertex ids (F, 3).
        roughness: Of the mesh (4,), mesh units, as ``_geom.mesh_roughness`` gives it, where it is known.
        ask: Called between the signs; what it raises stops the reading.

    Returns:
        The signs; of large meshes those of pixels, voxels and lines are those of an even sample.

    Choice: docs/choices.md#auto.
    """
    from gcnd.report import level_of

    # Squares of lengths must be numbers, whatever the unit.
    vertices = vertices - vertices[0]
    unit = float(np.abs(vertices).max()) or 1.0
    vertices /= unit
    edge = _geom.mean_edge_length(vertices, faces)
    ask()
    roughness = _geom.mesh_roughness(topology, vertices) if roughness is None else roughness / unit
    found = unevenness(vertices, faces)
    correlation = _correlation(faces, found.offsets)
    ask()
    lines = layer_lines(found, edge)
    ask()
    pixel_share = _pixel_share(vertices, faces[:: 1 + len(faces) // _MOST_SAMPLED])
    ask()
    voxel_share = _voxel_share(vertices[:: 1 + len(vertices) // _MOST_SAMPLED], edge)
    ask()
    return Signs(
        level=level_of(roughness, edge),
        correlation=correlation,
        pixel_share=pixel_share,
        voxel_share=voxel_share,
        area_ratio=_area_ratio(vertices, faces),
        line_share=lines.share,
        line_contrast=lines.contrast,
        line_reach=lines.reach,
        line_weakest_side=lines.weakest_side,
        line_wavelength=lines.wavelength,
    )


def _pixel_share(vertices: Points, faces: Faces) -> float:
    """Fits the direction d from which faces look equally large, N_f · d ≈ 1, N_f = area · normal, robustly.

    Faces of a frame are halves of pixels. Pixels further away are larger, so that areas are compared with the median.
    """
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.sqrt(np.square(areas).sum(axis=1).mean())
    if not size > 0:
        return 0.0
    areas /= size
    weights, direction = np.ones(len(areas)), np.zeros(3)
    for _ in range(_FITS):
        weighted = areas * weights[:, None]
        direction = np.linalg.lstsq(weighted.T @ areas, weighted.sum(axis=0), rcond=1e-12)[0]
        seen = areas @ direction
        middle = float(np.median(seen))
        if not middle > 0:
            return 0.0
        # Cauchy's weights: flying triangles and those turned away count little.
        weights = 1 / (1 + np.square((seen / middle - 1) / _AREA_TOLERANCE))
    is_even = np.abs(seen / middle - 1) < _AREA_TOLERANCE
    return float(np.mean(is_even & _are_half_squares(corners, direction)))


def _are_half_squares(corners: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which faces (F, 3, 3), seen along a direction, have a right angle between two sides of about one length."""
    towards = direction / np.linalg.norm(direction)
    flat = corners - (corners @ towards)[:, :, None] * towards
    squares = np.sort(np.square(flat - np.roll(flat, -1, axis=1)).sum(axis=2), axis=1)
    short, middle, long = squares.T
    # Pythagoras: c² = a² + b²; and b < 1.5 a.
    is_right = np.abs(long - short - middle) < _ANGLE_TOLERANCE * long
    halves: NDArray[np.bool_] = np.logical_and(is_right, middle < 1.5**2 * short)
    return halves


def _voxel_share(vertices: Points, edge: float) -> float:
    """Counts coordinates that a plane full of vertices shares; where surfaces cross voxels' edges two of three do."""
    if not edge > 0 or len(vertices) == 0:
        return 0.0
    fewest = max(_FEWEST_ON_PLANE, np.sqrt(len(vertices)) / 2)
    steps = np.round((vertices - vertices.min(axis=0)) / (_LATTICE_STEP * edge))
    shared = np.zeros(len(vertices), dtype=np.int64)
    for axis in range(3):
        _, place, counts = np.unique(steps[:, axis], return_inverse=True, return_counts=True)
        shared += counts[place] >= fewest
    return float(np.mean(shared == 2))


def _area_ratio(vertices: Points, faces: Faces) -> float:
    small, large = np.quantile(_geom.face_geometry(vertices, faces)[2], (0.1, 0.9))
    return float(large / small) if small > 0 else 1.0


def _correlation(faces: Faces, offsets: NDArray[np.float64]) -> float:
    """Correlation of offsets along edges, cut off at three times their median."""
    ids = faces.astype(np.int64)
    begin, end = ids.ravel(), np.roll(ids, -1, axis=1).ravel()
    is_used = np.bincount(begin, minlength=len(offsets)) > 0
    limit = 3 * float(np.median(np.abs(offsets[is_used])))
    offsets = np.clip(offsets, -limit, limit)
    size = float(np.square(offsets[begin]).mean())
    return float((offsets[begin] * offsets[end]).mean()) / size if size > 0 else 0.0
