"""Clean meshes and views that the tests of `gcnd.scans` share."""

from __future__ import annotations

import numpy as np
import trimesh

from gcnd.scans.camera import Camera
from gcnd.scans.raster import View


def ball(subdivisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), mesh.faces.astype(np.uint32)


def turned(faces: np.ndarray, is_turned: np.ndarray | None = None) -> np.ndarray:
    """Faces seen from the other side, all or those that are marked."""
    return np.where((True if is_turned is None else is_turned[:, None]), faces[:, [0, 2, 1]], faces)


def some_of(faces: np.ndarray, share: float = 0.4) -> np.ndarray:
    return np.random.default_rng(0).random(len(faces)) < share


def square() -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


def plane_view(camera: Camera, depth: float, tilt: float) -> View:
    """An endless plane at ``depth`` on the camera's axis, turned by ``tilt`` around the image's vertical."""
    normal = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    rays = camera.rays()
    points = rays * (normal[2] * depth / (rays @ normal))[..., None]
    cosine = np.abs(rays @ normal) / np.linalg.norm(rays, axis=2)
    return View(points, np.arccos(cosine))
