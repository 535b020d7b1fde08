"""Triangles between the pixels of a depth image."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from gcnd.data.noise import FaceArray, FloatArray

Diagonal = Literal["down", "up", "shorter"]
"""How a square of pixels is split: from its top left to its bottom right, the other way, or by the smaller step."""

PixelIds = npt.NDArray[np.int64]


def triangulate(
    noisy: FloatArray, exact: FloatArray, most_step: FloatArray, diagonal: Diagonal = "shorter"
) -> tuple[PixelIds, FaceArray]:
    """Joins neighbouring pixels of a depth image and cuts where depth jumps.

    Each square of four pixels gives two triangles, one with three known pixels gives one. A triangle stays whose three
    differences of depth are within the limit, in the noisy image, as a program that only has this would do it, and in
    the exact one, so that the truth has no triangle between two surfaces.

    Args:
        noisy: (H, W) depth, NaN where missing.
        exact: (H, W) depth, known wherever ``noisy`` is.
        most_step: (H, W) largest difference within a triangle; that of its first corner counts.
        diagonal: How squares are split.

    Returns:
        The pixels (V,) that triangles use, as row · W + column, ascending; and the triangles (F, 3) as places in that
        list, anticlockwise seen from the camera.

    Example:
        >>> image = np.array([[1.0, 1, 5], [1, 1, 5]])
        >>> pixels, faces = triangulate(image, image, np.full((2, 3), 0.5), "down")
        >>> pixels.tolist(), faces.tolist()
        ([0, 1, 3, 4], [[0, 2, 3], [0, 3, 1]])
    """
    height, width = noisy.shape
    ids = np.arange(height * width).reshape(height, width)
    a, b, c, d = (part.reshape(-1) for part in (ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]))
    flat = noisy.reshape(-1)
    known = np.isfinite(flat)
    falls = _falls(flat, known, (a, b, c, d), diagonal)
    first = np.where(falls[:, None], np.stack([a, d, c], axis=1), np.stack([a, d, b], axis=1))
    second = np.where(falls[:, None], np.stack([a, c, b], axis=1), np.stack([b, d, c], axis=1))
    triangles = np.stack([first, second], axis=1).reshape(-1, 3)
    triangles = triangles[known[triangles].all(axis=1)]
    limit = most_step.reshape(-1)[triangles[:, 0]]
    for image in (flat, exact.reshape(-1)):
        depths = image[triangles]
        stays = np.ptp(depths, axis=1) <= limit
        triangles, limit = triangles[stays], limit[stays]
    used, places = np.unique(triangles, return_inverse=True)
    return used, places.reshape(-1, 3).astype(np.uint32)


def _falls(
    depth: FloatArray,
    known: npt.NDArray[np.bool_],
    corners: tuple[PixelIds, PixelIds, PixelIds, PixelIds],
    diagonal: Diagonal,
) -> npt.NDArray[np.bool_]:
    """Whether each square is split from top left to bottom right; a square of three pixels has no choice."""
    a, b, c, d = corners
    if diagonal == "shorter":
        with np.errstate(invalid="ignore"):
            falls = np.abs(depth[a] - depth[c]) <= np.abs(depth[b] - depth[d])
    else:
        falls = np.full(len(a), diagonal == "down")
    return np.where(known[a] & known[c], falls | ~(known[b] & known[d]), False)
