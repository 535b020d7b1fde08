"""A clean mesh in, a pair of a simulated scan and its truth out."""

from __future__ import annotations

import dataclasses
from typing import Literal, TypeAlias, get_args

import numpy as np

from gcnd import _geom
from gcnd.data.noise import AnyFaces, FloatArray
from gcnd.errors import ConfigError, MeshError, check_count
from gcnd.scans.camera import look_at, random_direction
from gcnd.scans.frame import ScanPair, frame_pair
from gcnd.scans.fusion import Fusion, fused_pair
from gcnd.scans.grid import Diagonal
from gcnd.scans.kinect1 import Kinect1
from gcnd.scans.kinect2 import Kinect2
from gcnd.scans.printed import Print, printed_pair
from gcnd.start import near_1

ScanKind = Literal["kinect1", "kinect2", "fusion", "print"]
"""One frame of the first or the second Kinect, frames of the first fused, a print scanned."""

SCAN_KINDS: tuple[ScanKind, ...] = get_args(ScanKind)

Setting: TypeAlias = Kinect1 | Kinect2 | Fusion | Print

SETTINGS: dict[ScanKind, type[Setting]] = {
    "kinect1": Kinect1,
    "kinect2": Kinect2,
    "fusion": Fusion,
    "print": Print,
}

DEFAULT_SIZE = 0.4
"""Metres, of the diagonal of an object's bounding box."""

DEFAULT_DISTANCES: dict[ScanKind, float] = {"kinect1": 0.8, "kinect2": 1.2, "fusion": 0.8}
"""Metres from the camera to the middle of the object."""

_LARGEST = 100.0


def simulate(
    kind: ScanKind,
    vertices: FloatArray,
    faces: AnyFaces,
    *,
    seed: int = 0,
    size: float = DEFAULT_SIZE,
    distance: float | None = None,
    view: FloatArray | None = None,
    setting: Setting | None = None,
    diagonal: Diagonal = "shorter",
) -> ScanPair:
    """Makes a pair of a simulated scan of a clean mesh and its truth.

    Sensors measure in metres, so the mesh is first scaled until the diagonal of its bounding box is ``size`` metres,
    and the pair is scaled back: it lies on the clean mesh, in its unit. ``print`` depends on no unit.

    - ``kinect1``, ``kinect2``: a grid of pixels seen from one side, cut where depth jumps; the truth is the same pixels
      with exact depth.
    - ``fusion``: marching cubes on fused frames; the truth is each vertex's nearest point on the clean mesh.
    - ``print``: the clean mesh's own faces and vertices, moved.

    Args:
        kind: One of `SCAN_KINDS`.
        vertices: (V, 3) float64, clean positions in mesh units.
        faces: (F, 3), vertex ids; for ``print`` neighbours agree on which side is out. A camera sees both sides, and
            ``fusion`` finds out by itself, see `gcnd.scans.sides`.
        seed: Of everything that is drawn, >= 0; the same seed gives the same pair.
        size: Metres, above 0 to 100. Not used by ``print``.
        distance: Metres from the camera to the middle of the object; by default `DEFAULT_DISTANCES`. It must leave the
            sensor's smallest distance to the object's bounding sphere. Not used by ``print``.
        view: (3,) direction from the object to the camera, in the mesh's frame; by default drawn. Only of one frame.
        setting: A `Kinect1`, `Kinect2`, `Fusion` or `Print` of other numbers than the default ones.
        diagonal: How squares of pixels are split; only of one frame.

    Returns:
        The pair, in mesh units.

    Raises:
        ConfigError: An unknown kind, a setting of another one, or a number outside its range.
        MeshError: A face has an id that is no vertex, a position is not finite, there is no face, all vertices lie at
            one point, the scan found no surface, or the truth of a fused one is folded.
        GcndError: ``fusion`` without scikit-image.

    Warns:
        MeshWarning: A fused scan is far off the mesh, as of a surface without thickness.

    Paper: Sec. 7.1, the scanned data sets. Choice: docs/choices.md#simulated-scans; every number in docs/scans.md.

    Example:
        >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        >>> ids = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
        >>> pair = simulate("kinect1", square, ids, seed=1, view=np.array([0.0, 0, 1]))
        >>> len(pair.faces) > 50_000, bool(np.abs(pair.clean_vertices[:, 2]).max() < 1e-12)
        (True, True)
    """
    chosen = _checked_setting(kind, setting)
    seed = check_count("seed", seed)
    clean = np.ascontiguousarray(vertices, dtype=np.float64)
    ids = np.ascontiguousarray(faces, dtype=np.uint32)
    _geom.validate(clean, ids)
    rng = np.random.default_rng([seed, SCAN_KINDS.index(kind)])
    used, places = np.unique(ids, return_inverse=True)
    positions, doublings = near_1(clean, ids)
    low, high = positions[used].min(axis=0), positions[used].max(axis=0)
    middle, diagonal_length = (low + high) / 2, float(np.linalg.norm(high - low))
    if diagonal_length == 0:
        raise MeshError("all vertices lie at one point")
    if isinstance(chosen, Print):
        moved = np.ldexp(_printed(positions, ids, chosen, rng).noisy_vertices, -doublings)
        if doublings:  # what no face uses waited at the origin
            moved = np.where(np.isin(np.arange(len(clean)), used)[:, None], moved, clean)
        return ScanPair(moved, clean, ids)
    away = DEFAULT_DISTANCES[kind] if distance is None else distance
    _check_lengths(size, away, chosen.sensor if isinstance(chosen, Fusion) else chosen)
    scale = size / diagonal_length
    placed, triangles = (positions[used] - middle) * scale, places.reshape(-1, 3)
    if isinstance(chosen, Fusion):
        pair = fused_pair(placed, triangles, away, chosen, rng)
    else:
        direction = random_direction(rng) if view is None else _checked_view(view)
        pose = look_at(np.zeros(3), direction, away, 0.0)
        pair = frame_pair(placed, triangles, chosen, pose, rng, diagonal)
    if len(pair.faces) == 0:
        raise MeshError(
            f"the {kind} scan found no surface",
            hint="a larger size, a smaller distance or another seed may help",
        )
    noisy, truth = (np.ldexp(own / scale + middle, -doublings) for own in pair[:2])
    return ScanPair(noisy, truth, pair.faces)


def _printed(clean: FloatArray, faces: AnyFaces, setting: Print, rng: np.random.Generator) -> ScanPair:
    """Vertices that a file repeats at one position move together."""
    representatives, welded = _geom.weld(clean)
    pair = printed_pair(clean[representatives], welded[faces], setting, rng)
    return ScanPair(pair.noisy_vertices[welded], clean, np.asarray(faces, dtype=np.uint32))


def _checked_setting(kind: str, setting: Setting | None) -> Setting:
    settings: dict[str, type[Setting]] = {name: SETTINGS[name] for name in SCAN_KINDS}
    if kind not in settings:
        raise ConfigError(f"unknown kind of scan {kind!r}", hint=f"use one of {', '.join(SCAN_KINDS)}")
    wanted = settings[kind]
    if setting is None:
        return wanted()
    if not isinstance(setting, wanted):
        raise ConfigError(f"setting of {kind} is a {type(setting).__name__}, allowed: {wanted.__name__}")
    for field, value in _numbers(setting).items():
        if not (np.isfinite(value) and value >= 0):
            raise ConfigError(f"{field} of {kind} is {value}, allowed: finite and 0 or more")
        if field in _POSITIVE and value == 0:
            raise ConfigError(f"{field} of {kind} is {value}, allowed: above 0")
        if value > _AT_MOST.get(field, np.inf):
            raise ConfigError(f"{field} of {kind} is {value}, allowed: up to {_AT_MOST[field]}")
    return setting


_POSITIVE = (
    "baseline",
    "steps_per_pixel",
    "depth_step",
    "least_albedo",
    "spots",
    "voxel",
    "truncation",
    "n_frames",
)

_AT_MOST = {"steepest": 1.55, "least_albedo": 1.0}
"""Deviations have no bound at a right angle, 1.571."""


def _numbers(setting: Setting) -> dict[str, float]:
    """The plain numbers of a setting and of its sensor, by name."""
    found: dict[str, float] = {}
    for part in dataclasses.fields(setting):
        value = getattr(setting, part.name)
        if isinstance(value, int | float):
            found[part.name] = value
    if isinstance(setting, Fusion):
        found |= _numbers(setting.sensor)
    return found


def _check_lengths(size: float, distance: float, sensor: Kinect1 | Kinect2) -> None:
    if not 0 < size <= _LARGEST:
        raise ConfigError(f"size is {size}, allowed: above 0 to {_LARGEST:.0f} metres")
    least = size / 2 + sensor.nearest
    if not least <= distance <= _LARGEST:
        raise ConfigError(
            f"distance is {distance}, allowed: {least:g} to {_LARGEST:.0f} metres",
            hint=f"half the size of {size:g} and the sensor's smallest distance of {sensor.nearest:g}",
        )


def _checked_view(view: FloatArray) -> FloatArray:
    direction = np.asarray(view, dtype=np.float64)
    if direction.shape != (3,) or not np.all(np.isfinite(direction)) or not np.any(direction):
        raise ConfigError(
            f"view is {np.asarray(view).tolist()}, allowed: three finite numbers, not all 0",
            hint="it is the direction from the object to the camera",
        )
    return direction
