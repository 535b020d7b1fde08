"""One frame of a depth camera as a pair of meshes."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from gcnd.data.noise import AnyFaces, FaceArray, FloatArray
from gcnd.errors import MeshError
from gcnd.scans.camera import Camera, Pose
from gcnd.scans.grid import Diagonal, triangulate
from gcnd.scans.raster import View, render

_MARGIN = 4
"""Pixels around the object: the silhouette is an edge on every side."""


class ScanPair(NamedTuple):
    """A noisy mesh and its truth.

    Attributes:
        noisy_vertices: (V, 3) float64.
        clean_vertices: (V, 3) float64, on the clean surface.
        faces: (F, 3) uint32, of both.
    """

    noisy_vertices: FloatArray
    clean_vertices: FloatArray
    faces: FaceArray


class DepthSensor(Protocol):
    """Measures depth."""

    @property
    def camera(self) -> Camera:
        """Its intrinsics."""
        ...

    @property
    def jump(self) -> float:
        """Depth difference that counts as another surface, in widths of a pixel on the object."""
        ...

    def measure(self, view: View, rng: np.random.Generator) -> FloatArray:
        """Returns the measured depth (H, W) of a view, NaN where missing."""
        ...


class DepthFrame(NamedTuple):
    """What a sensor told, beside what was there.

    Attributes:
        camera: The part of the sensor's image that holds the object.
        exact: What an ideal camera sees.
        depth: (H, W) metres as measured, NaN where missing.
    """

    camera: Camera
    exact: View
    depth: FloatArray


def take_frame(
    vertices: FloatArray, faces: AnyFaces, sensor: DepthSensor, pose: Pose, rng: np.random.Generator
) -> DepthFrame:
    """Takes one frame of a clean mesh.

    Args:
        vertices: (V, 3) float64 in metres, in the world.
        faces: (F, 3), vertex ids.
        sensor: What measures.
        pose: Where it stands.
        rng: Draws the sensor's noise.

    Raises:
        MeshError: A vertex is not in front of the camera.
    """
    seen_from = pose.to_camera(vertices)
    behind = seen_from[:, 2] <= 0
    if behind.any():
        raise MeshError(f"vertex {int(np.argmax(behind))} is not in front of the camera")
    camera = sensor.camera.cropped(seen_from, _MARGIN)
    exact = render(seen_from, faces, camera)
    return DepthFrame(camera, exact, sensor.measure(exact, rng))


def frame_pair(
    vertices: FloatArray,
    faces: AnyFaces,
    sensor: DepthSensor,
    pose: Pose,
    rng: np.random.Generator,
    diagonal: Diagonal = "shorter",
) -> ScanPair:
    """Makes a pair of one frame: measured pixels joined to triangles, and the same pixels with exact depth.

    A measured pixel lies on its ray, p' = (z' / z) p with p the exact point.

    Args:
        vertices: (V, 3) float64 in metres, in the world.
        faces: (F, 3), vertex ids.
        sensor: What measures.
        pose: Where it stands.
        rng: Draws the sensor's noise.
        diagonal: How squares of pixels are split.

    Returns:
        The pair in the world, metres; no faces where nothing was measured.

    Raises:
        MeshError: A vertex is not in front of the camera.
    """
    frame = take_frame(vertices, faces, sensor, pose, rng)
    limit = sensor.jump * frame.exact.depth / frame.camera.focal
    pixels, triangles = triangulate(frame.depth, frame.exact.depth, limit, diagonal)
    exact = frame.exact.points.reshape(-1, 3)[pixels]
    stretch = frame.depth.reshape(-1)[pixels] / exact[:, 2]
    return ScanPair(pose.to_world(exact * stretch[:, None]), pose.to_world(exact), triangles)
