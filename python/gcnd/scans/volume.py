"""A truncated signed distance field on a grid: depth frames go in, a mesh comes out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from gcnd.data.noise import FaceArray, FloatArray
from gcnd.errors import ConfigError, GcndError
from gcnd.scans.camera import Camera, Pose

_MOST_VOXELS = 200_000_000


class Volume:
    """Voxels near the surface, each with the mean of the signed distances that frames give it.

    D(x) = Σ_k clip(η_k / μ) / Σ_k 1 over the frames k that see x with η_k ≥ −μ, where η_k is the measured depth at the
    pixel of x, less the depth of x.

    Args:
        points: (N, 3) measured points in the world; voxels further from all of them than the truncation do not count.
        voxel: Side of a voxel, in the unit of the points.
        truncation: μ, in the unit of the points.

    Raises:
        ConfigError: The box around the points has more than 200 million voxels.

    Source: Curless and Levoy 1996 (`curless1996`), Newcombe et al. 2011 (`newcombe2011`).
    """

    def __init__(self, points: FloatArray, voxel: float, truncation: float) -> None:
        margin = truncation + 2 * voxel
        self.origin = points.min(axis=0) - margin
        self.voxel, self.truncation = voxel, truncation
        shape = np.ceil((points.max(axis=0) + margin - self.origin) / voxel).astype(np.int64) + 1
        n_voxels = float(np.prod(shape.astype(np.float64)))
        if n_voxels > _MOST_VOXELS:
            raise ConfigError(
                f"voxel is {voxel:g}: the volume would have {n_voxels:.3g} voxels, allowed: {_MOST_VOXELS:.3g}",
                hint="take a smaller size, or in Python a larger `Fusion.voxel`",
            )
        empty = np.ones(shape, dtype=bool)
        empty[tuple(np.rint((points - self.origin) / voxel).astype(np.int64).T)] = False
        # One voxel more than μ: the nearest point was rounded to a voxel.
        near = ndimage.distance_transform_edt(empty, sampling=voxel) <= truncation + voxel
        self.ids: npt.NDArray[np.int64] = np.argwhere(near)
        self.shape = tuple(int(n) for n in shape)
        self.centers = self.origin + self.ids * voxel
        self.total = np.zeros(len(self.ids))
        self.count = np.zeros(len(self.ids))

    def add(self, depth: FloatArray, camera: Camera, pose: Pose) -> None:
        """Adds a frame.

        Args:
            depth: (H, W), NaN where missing.
            camera: Its intrinsics.
            pose: Where the frame is believed to be from.
        """
        local = pose.to_camera(self.centers)
        u, v = (np.rint(value).astype(np.int64) for value in camera.project(local))
        seen = np.flatnonzero((u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height))
        distance = depth[v[seen], u[seen]] - local[seen, 2]
        valid = distance >= -self.truncation
        seen = seen[valid]
        self.total[seen] += np.minimum(distance[valid] / self.truncation, 1.0)
        self.count[seen] += 1.0

    def extract(self) -> tuple[FloatArray, FaceArray]:
        """Extracts the surface where the field is 0, in cubes whose eight corners have all been seen.

        Returns:
            Vertices (V, 3) in the world and faces (F, 3), anticlockwise seen from outside; (0, 3) both where there is
            no surface.

        Raises:
            GcndError: scikit-image is not installed.
        """
        try:
            from skimage.measure import marching_cubes
        except ImportError as error:
            raise GcndError(
                "fused scans need scikit-image", hint="pip install 'gcnd[scan]', or take another kind"
            ) from error
        known = self.count > 0
        field = np.ones(self.shape)
        seen = np.zeros(self.shape, dtype=bool)
        place = tuple(self.ids[known].T)
        field[place] = self.total[known] / self.count[known]
        seen[place] = True
        whole = _whole_cubes(seen)
        in_cubes = field[1:, 1:, 1:][whole[1:, 1:, 1:]]
        if not (in_cubes.size and in_cubes.min() < 0 < in_cubes.max()):
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint32)
        extracted = marching_cubes(  # type: ignore[no-untyped-call]
            field, 0.0, mask=whole, gradient_direction="descent"
        )
        vertices, faces = extracted[:2]
        placed = self.origin + np.asarray(vertices, dtype=np.float64) * self.voxel
        return placed, np.ascontiguousarray(faces, dtype=np.uint32)


def _whole_cubes(seen: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Marks the last corner, that of the largest indices, of every cube whose eight corners have been seen.

    This is the corner at which scikit-image looks whether a cube counts.
    """
    whole = np.zeros_like(seen)
    corners = [slice(None, -1), slice(1, None)]
    whole[1:, 1:, 1:] = np.logical_and.reduce(
        [seen[i, j, k] for i in corners for j in corners for k in corners]
    )
    return whole
