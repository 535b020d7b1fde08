"""Several depth frames fused into one mesh, as Kinect Fusion does it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from gcnd.data.noise import AnyFaces, FaceArray, FloatArray
from gcnd.errors import MeshError, MeshWarning
from gcnd.scans.camera import Pose, look_at, random_direction
from gcnd.scans.frame import DepthFrame, ScanPair, take_frame
from gcnd.scans.kinect1 import Kinect1
from gcnd.scans.truth import project_truth
from gcnd.scans.volume import Volume

_MOST_FOLDED = 0.05
"""Share of the faces that may be left out because their truth is folded: up to 0.024 on what is trained on."""

_FAR_VOXELS, _MOST_FAR = 2.0, 0.1
"""A scan is told to have failed when a larger share of its vertices is further off than so many voxels."""


@dataclass(frozen=True)
class Fusion:
    """How frames are taken and fused; docs/scans.md has the source of every number.

    Attributes:
        sensor: What takes the frames.
        n_frames: How many, spread over an orbit.
        voxel: Side of a voxel, metres.
        truncation: μ in voxels.
        turn_error: Deviation of the angle by which a frame's pose is believed wrongly, radians.
        shift_error: Deviation of each coordinate of that pose, metres.
        elevation: Lowest and highest angle of the orbit over the object's equator, radians. What is below stays unseen.
        fewest_faces: Pieces of fewer faces are left out, as they are specks in the air.
    """

    sensor: Kinect1 = field(default_factory=Kinect1)
    n_frames: int = 12
    voxel: float = 0.004
    truncation: float = 4.0
    turn_error: float = float(np.deg2rad(0.25))
    shift_error: float = 0.001
    elevation: tuple[float, float] = (float(np.deg2rad(-15)), float(np.deg2rad(55)))
    fewest_faces: int = 100


def fused_pair(
    vertices: FloatArray, faces: AnyFaces, distance: float, fusion: Fusion, rng: np.random.Generator
) -> ScanPair:
    """Makes a pair of a fused scan: marching cubes on the fused distances, and its vertices on the clean surface.

    Args:
        vertices: (V, 3) float64 in metres.
        faces: (F, 3), vertex ids.
        distance: Metres from the camera to the middle of the object.
        fusion: How frames are taken and fused.
        rng: Draws everything.

    Returns:
        The pair, metres; no faces where nothing was measured. Faces whose truth is folded are left out of both.

    Raises:
        GcndError: scikit-image is not installed.
        MeshError: A vertex is not in front of a camera, or the truth of more than a twentieth of the faces is folded.

    Warns:
        MeshWarning: More than a tenth of the scan's vertices lie more than two voxels off the mesh.

    Choice: docs/choices.md#truth-of-a-fused-scan.
    """
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    shots: list[tuple[DepthFrame, Pose]] = []
    for pose in orbit(middle, distance, fusion, rng):
        frame = take_frame(vertices, faces, fusion.sensor, pose, rng)
        error = rng.standard_normal((2, 3)) * [[fusion.turn_error], [fusion.shift_error]]
        shots.append((frame, pose.disturbed(error[0], error[1], middle)))
    measured = np.concatenate([_points(frame, believed) for frame, believed in shots])
    if len(measured) == 0:
        return _nothing()
    volume = Volume(measured, fusion.voxel, fusion.truncation * fusion.voxel)
    for frame, believed in shots:
        volume.add(frame.depth, frame.camera, believed)
    noisy, triangles = _without_specks(*volume.extract(), fusion.fewest_faces)
    if len(triangles) == 0:
        return _nothing()
    truth, folded = project_truth(noisy, triangles, vertices, faces)
    _check(float(folded.mean()), np.linalg.norm(noisy - truth, axis=1) / fusion.voxel)
    used, places = np.unique(triangles[~folded], return_inverse=True)
    return ScanPair(noisy[used], truth[used], places.reshape(-1, 3).astype(np.uint32))


def _check(folded: float, voxels_off: FloatArray) -> None:
    """Refuses a truth that is none, and tells of a scan that is none."""
    if folded > _MOST_FOLDED:
        raise MeshError(
            f"the truth of {folded:.0%} of the fused faces is folded, allowed: {_MOST_FOLDED:.0%}",
            hint="the mesh may cross itself, or be thinner than a voxel: a larger size may help",
        )
    far = float((voxels_off > _FAR_VOXELS).mean())
    if far > _MOST_FAR:
        # Seen from the caller of `simulate`.
        warnings.warn(
            f"{far:.0%} of the fused vertices lie more than {_FAR_VOXELS:g} voxels off the mesh: frames from both "
            "sides of a surface without thickness cancel, and so they do at thin walls, where a larger size helps",
            MeshWarning,
            stacklevel=4,
        )


def orbit(target: FloatArray, distance: float, fusion: Fusion, rng: np.random.Generator) -> list[Pose]:
    """Returns poses around an object, evenly in azimuth around an axis drawn at random, elevations drawn evenly."""
    axis = random_direction(rng)
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    azimuths = 2 * np.pi * (np.arange(fusion.n_frames) + rng.random()) / fusion.n_frames
    elevations = rng.uniform(*fusion.elevation, fusion.n_frames)
    poses = []
    for azimuth, elevation in zip(azimuths, elevations, strict=True):
        level = np.cos(azimuth) * side + np.sin(azimuth) * other
        direction = np.cos(elevation) * level + np.sin(elevation) * axis
        poses.append(look_at(target, direction, distance, float(rng.uniform(-0.2, 0.2))))
    return poses


def _points(frame: DepthFrame, believed: Pose) -> FloatArray:
    """(N, 3): measured pixels in the world, where the fusing program believes them."""
    points = frame.camera.rays() * frame.depth[..., None]
    return believed.to_world(points[np.isfinite(frame.depth)])


def _without_specks(
    vertices: FloatArray, faces: FaceArray, fewest_faces: int
) -> tuple[FloatArray, FaceArray]:
    if len(faces) == 0:
        return vertices, faces
    links = faces[:, [0, 1, 1, 2]].reshape(-1, 2).astype(np.int64)
    graph = sparse.coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(vertices),) * 2)
    label: npt.NDArray[np.int32] = connected_components(graph, directed=False)[1]
    size = np.bincount(label[faces[:, 0]], minlength=int(label.max()) + 1)
    kept = faces[size[label[faces[:, 0]]] >= fewest_faces]
    used, places = np.unique(kept, return_inverse=True)
    return vertices[used], places.reshape(-1, 3).astype(np.uint32)


def _nothing() -> ScanPair:
    return ScanPair(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint32))
