"""The first Kinect: structured light, a block matcher, depth in whole steps of disparity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from gcnd.data.noise import FloatArray
from gcnd.scans.camera import Camera
from gcnd.scans.raster import View
from gcnd.scans.window import BoolArray, averaged_inside, correlated_field, gaussian_window, on_edges

CAMERA = Camera.centered(640, 480, 585.0)
"""The first Kinect's depth image."""


@dataclass(frozen=True)
class Kinect1:
    """A structured-light camera; docs/scans.md has the source of every number.

    Attributes:
        camera: 640 × 480 pixels, f = 585.
        baseline: Metres between camera and projector; the projector is on the camera's −x side.
        steps_per_pixel: Disparity is told in steps of 1 / this many pixels.
        window: Deviation in pixels of the Gaussian in place of the matcher's 9 × 9 window, √((81 − 1) / 12).
        nearest: Metres; what is nearer is missing.
        steepest: Angle of incidence, radians, from which on nothing is measured.
        dropout_from: Angle of incidence, radians, above which pixels start to be missing.
        jump: Depth difference that counts as another surface, in widths of a pixel on the object.
        noise: Factor on σ_z; below 1 for a program that averages frames or filters depth.
    """

    camera: Camera = CAMERA
    baseline: float = 0.075
    steps_per_pixel: float = 8.0
    window: float = float(np.sqrt(80 / 12))
    nearest: float = 0.4
    steepest: float = float(np.deg2rad(80))
    dropout_from: float = float(np.deg2rad(60))
    jump: float = 8.0
    noise: float = 1.0

    def depth_step(self, depth: FloatArray) -> FloatArray:
        """Returns the depth (…,) in metres between steps of disparity: Δz = z² / (s f b), s steps a pixel."""
        return np.asarray(np.square(depth) / (self.steps_per_pixel * self.camera.focal * self.baseline))

    def quantized(self, depth: FloatArray) -> FloatArray:
        """Returns the depth of the nearest whole step of disparity d = f b / z; NaN stays NaN."""
        product = self.steps_per_pixel * self.camera.focal * self.baseline
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(product / np.maximum(np.rint(product / depth), 1.0))

    def measure(self, view: View, rng: np.random.Generator) -> FloatArray:
        """Returns the depth that the sensor tells of a view.

        z' = Q(mean of z over the window + ε √(σ_z² − Δz² / 12)), Q rounding to whole steps of disparity, ε correlated
        as the window leaves it: with the variance Δz² / 12 that rounding adds, the deviation is σ_z.

        Args:
            view: What an ideal camera sees, metres. Pixels beside it do not exist for the sensor.
            rng: Draws noise and missing pixels.

        Returns:
            (H, W) metres, NaN where nothing is measured: nothing there, in the projector's shadow, on a ragged edge,
            too near, too steep.
        """
        depth, angles = view.depth, view.angles
        limit = self.jump * depth / self.camera.focal
        seen = self._seen(view, limit, rng)
        kernel = gaussian_window(self.window)
        sigma = self.noise * axial_deviation(depth, np.minimum(angles, self.steepest))
        rounding = np.square(self.depth_step(depth)) / 12
        spread = np.sqrt(np.maximum(np.square(sigma) - rounding, 0.0))
        mean = averaged_inside(depth, kernel, limit * len(kernel) / 2)
        noisy = mean + spread * correlated_field(rng, depth.shape, kernel)
        noisy[~seen | (noisy < self.nearest)] = np.nan
        return self.quantized(noisy)

    def _seen(self, view: View, limit: FloatArray, rng: np.random.Generator) -> BoolArray:
        depth, angles = view.depth, view.angles
        # The matcher fails for whole windows: what is missing is correlated as noise is.
        share = special.ndtr(correlated_field(rng, depth.shape, gaussian_window(self.window)))
        steep = angles > self.dropout_from + share * (self.steepest - self.dropout_from)
        shadow = in_shadow(depth, self.camera.focal * self.baseline)
        ragged = self._beyond_edge(depth, angles, limit, rng)
        return np.isfinite(depth) & ~steep & ~shadow & ~ragged

    def _beyond_edge(
        self, depth: FloatArray, angles: FloatArray, limit: FloatArray, rng: np.random.Generator
    ) -> BoolArray:
        """Pixels whose lateral error of σ_L reaches across a silhouette or onto another surface."""
        rows, columns = np.indices(depth.shape)
        deviation = lateral_deviation(np.nan_to_num(np.minimum(angles, self.steepest)))
        height, width = depth.shape
        kernel = gaussian_window(1.0)
        moved = [
            np.rint(index + deviation * correlated_field(rng, depth.shape, kernel)).astype(np.int64)
            for index in (rows, columns)
        ]
        found = depth[np.clip(moved[0], 0, height - 1), np.clip(moved[1], 0, width - 1)]
        reached: BoolArray = ~(np.abs(found - depth) <= limit)
        return reached & (on_edges(depth, limit) | ~np.isfinite(found))


def axial_deviation(depth: FloatArray, angle: FloatArray) -> FloatArray:
    """Returns the deviation of the first Kinect's depth on a plane.

    σ_z = 0.0012 + 0.0019 (z − 0.4)² + 0.0001 / √z · θ² / (π/2 − θ)².

    Args:
        depth: z (…,) in metres.
        angle: θ (…,) between the surface's normal and the line of sight, radians, below π/2.

    Returns:
        (…,) metres.

    Source: Nguyen, Izadi and Lovell 2012 (`nguyen2012`), the axial model.

    Example:
        >>> float(axial_deviation(np.array(0.4), np.array(0.0)))
        0.0012
    """
    steep = np.square(angle / (np.pi / 2 - angle))
    return np.asarray(0.0012 + 0.0019 * np.square(depth - 0.4) + 0.0001 / np.sqrt(depth) * steep)


def lateral_deviation(angle: FloatArray) -> FloatArray:
    """Returns the deviation of the place of an edge in the image: σ_L = 0.8 + 0.035 θ / (π/2 − θ).

    Args:
        angle: θ (…,) radians, below π/2.

    Returns:
        (…,) pixels.

    Source: Nguyen, Izadi and Lovell 2012 (`nguyen2012`), the lateral model.

    Example:
        >>> round(float(lateral_deviation(np.array(np.pi / 4))), 6)
        0.835
    """
    return np.asarray(0.8 + 0.035 * angle / (np.pi / 2 - angle))


def in_shadow(depth: FloatArray, focal_baseline: float) -> BoolArray:
    """Says which pixels the projector does not light, because a nearer surface stands before them.

    A point at column u is lit along column u + f b / z of the projector, which stands on the camera's −x side. Light
    reaches a pixel only if no pixel to its left in its row needs a column as far right: seen from the projector, that
    one is in front.

    Args:
        depth: (H, W) metres, NaN where nothing is.
        focal_baseline: f b, pixels times metres.

    Returns:
        (H, W), False where ``depth`` is NaN.

    Example:
        >>> in_shadow(np.array([[1.0, 1, 2, 2, 2, 2]]), 4.0).tolist()
        [[False, False, True, True, False, False]]
    """
    column = np.where(np.isfinite(depth), np.arange(depth.shape[1]) + focal_baseline / depth, -np.inf)
    furthest = np.maximum.accumulate(column, axis=1)
    before = np.concatenate([np.full((len(depth), 1), -np.inf), furthest[:, :-1]], axis=1)
    return np.asarray(np.isfinite(depth) & (before >= column))
