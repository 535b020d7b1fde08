"""The second Kinect: time of flight, noise that grows as light gets faint, and pixels that fly at edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gcnd.data.noise import FloatArray
from gcnd.scans.camera import Camera
from gcnd.scans.raster import View
from gcnd.scans.window import averaged_inside, correlated_field, gaussian_window, on_edges

CAMERA = Camera.centered(512, 424, 366.0)
"""The second Kinect's depth image."""


@dataclass(frozen=True)
class Kinect2:
    """A time-of-flight camera; docs/scans.md has the source of every number.

    Attributes:
        camera: 512 × 424 pixels, f = 366.
        depth_step: Metres; depth is told in whole ones.
        window: Deviation in pixels of the Gaussian in place of the driver's 3 × 3 filter, √((9 − 1) / 12).
        least_albedo: Of the faintest spots, 1 being what the noise was measured on; from 0, excluded, to 1.
        spots: Size of the spots of even albedo in metres.
        nearest: Metres; what is nearer is missing.
        steepest: Angle of incidence, radians, from which on nothing is measured.
        background: Metres between the object and the wall behind it, whose light mixes with that of a silhouette.
        jump: Depth difference that counts as another surface, in widths of a pixel on the object.
        noise: Factor on σ_z; below 1 for a program that averages frames or filters depth.
    """

    camera: Camera = CAMERA
    depth_step: float = 0.001
    window: float = float(np.sqrt(8 / 12))
    least_albedo: float = 0.5
    spots: float = 0.1
    nearest: float = 0.5
    steepest: float = float(np.deg2rad(80))
    background: float = 0.5
    jump: float = 8.0
    noise: float = 1.0

    def measure(self, view: View, rng: np.random.Generator) -> FloatArray:
        """Returns the depth that the sensor tells of a view.

        z' = Q(mean of z over the window + ε √(σ_z² / ρ − Δz² / 12)), ρ the albedo, Q rounding to whole Δz, ε correlated
        as the window leaves it. A pixel on an edge sees the share w of its light from its own surface and the rest from
        the one behind: its z is w z + (1 − w) z_behind, w from ½ to 1.

        Args:
            view: What an ideal camera sees, metres.
            rng: Draws noise, albedo and shares.

        Returns:
            (H, W) metres, NaN where nothing is measured: nothing there, too near, too steep.
        """
        depth, angles = view.depth, view.angles
        limit = self.jump * depth / self.camera.focal
        kernel = gaussian_window(self.window)
        sigma = self.noise * axial_deviation(depth, np.minimum(angles, self.steepest))
        variance = np.square(sigma) / self._albedo(view.points, rng)
        spread = np.sqrt(np.maximum(variance - self.depth_step**2 / 12, 0.0))
        mean = averaged_inside(depth, kernel, limit * len(kernel) / 2)
        noisy = self._mixed(mean, limit, rng) + spread * correlated_field(rng, depth.shape, kernel)
        noisy[(noisy < self.nearest) | (angles > self.steepest)] = np.nan
        return np.asarray(np.rint(noisy / self.depth_step) * self.depth_step)

    def _mixed(self, depth: FloatArray, limit: FloatArray, rng: np.random.Generator) -> FloatArray:
        wall = np.nanmax(depth, initial=0.0) + self.background
        behind = ndimage.maximum_filter(np.where(np.isfinite(depth), depth, wall), 3, mode="nearest")
        share = rng.uniform(0.5, 1.0, depth.shape)
        flying = on_edges(depth, limit) & (behind - depth > limit)
        return np.where(flying, share * depth + (1 - share) * behind, depth)

    def _albedo(self, points: FloatArray, rng: np.random.Generator) -> FloatArray:
        """A smooth random field over the surface, from `least_albedo` to 1: the mean of four waves through space."""
        waves = rng.standard_normal((3, 4)) * (2 * np.pi / (2 * self.spots)) / np.sqrt(3)
        mean = np.cos(points @ waves + rng.uniform(0, 2 * np.pi, 4)).mean(axis=-1)
        return np.asarray(self.least_albedo + (1 - self.least_albedo) * (0.5 + 0.5 * mean))


def axial_deviation(depth: FloatArray, angle: FloatArray) -> FloatArray:
    """Returns the deviation of the second Kinect's depth on a plane, indoors.

    σ_z = 1.5 − 0.5 z + 0.3 z² + 0.1 √z³ · θ² / (π/2 − θ)², in millimetres.

    Args:
        depth: z (…,) in metres.
        angle: θ (…,) between the surface's normal and the line of sight, radians, below π/2.

    Returns:
        (…,) metres.

    Source: Fankhauser et al. 2015 (`fankhauser2015`), the axial model.

    Example:
        >>> round(float(axial_deviation(np.array(1.0), np.array(0.0))), 6)
        0.0013
    """
    steep = np.square(angle / (np.pi / 2 - angle))
    millimetres = 1.5 - 0.5 * depth + 0.3 * np.square(depth) + 0.1 * np.power(depth, 1.5) * steep
    return np.asarray(1e-3 * millimetres)
