"""What a sensor does to neighbouring pixels: it averages over a window, of the depth and of its own noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from gcnd.data.noise import FloatArray

BoolArray = npt.NDArray[np.bool_]


def gaussian_window(deviation: float) -> FloatArray:
    """Returns a Gaussian kernel (2 r + 1,) that sums to 1, r three deviations in pixels, rounded up.

    Example:
        >>> gaussian_window(0.0).tolist()
        [1.0]
    """
    if deviation == 0:
        return np.ones(1)
    reach = int(np.ceil(3 * deviation))
    kernel = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / deviation))
    return np.asarray(kernel / kernel.sum(), dtype=np.float64)


def correlated_field(rng: np.random.Generator, shape: tuple[int, int], kernel: FloatArray) -> FloatArray:
    """Draws normal noise with the correlation that averaging by a kernel leaves, variance 1 at every pixel.

    ε = (k ⊗ k) * w / |k|², w independent N(0, 1) on an image large enough that its rim does not matter.

    Args:
        rng: Draws w.
        shape: (H, W).
        kernel: (2 r + 1,), applied along rows and along columns.

    Returns:
        (H, W) float64.

    Example:
        >>> field = correlated_field(np.random.default_rng(0), (300, 300), gaussian_window(2.0))
        >>> bool(abs(field.std() - 1) < 0.05)
        True
    """
    reach = len(kernel) // 2
    white = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach))
    white = ndimage.correlate1d(white, kernel, axis=0, mode="nearest")
    white = ndimage.correlate1d(white, kernel, axis=1, mode="nearest")
    inner = white[reach : reach + shape[0], reach : reach + shape[1]]
    return np.asarray(inner / np.square(kernel).sum(), dtype=np.float64)


def averaged_inside(values: FloatArray, kernel: FloatArray, most_range: FloatArray) -> FloatArray:
    """Averages an image by a kernel, except near jumps.

    Missing pixels have no weight. A pixel whose window spans more than it may keeps its value.

    Args:
        values: (H, W), NaN where missing.
        kernel: (2 r + 1,), applied along rows and along columns.
        most_range: (H, W), the largest difference that may be averaged over.

    Returns:
        (H, W), NaN where ``values`` is.

    Example:
        >>> row = np.array([[0.0, 0, 0, 9, 9, 9]])
        >>> averaged_inside(row, np.ones(3) / 3, np.ones((1, 6))).tolist()
        [[0.0, 0.0, 0.0, 9.0, 9.0, 9.0]]
    """
    known = np.isfinite(values)
    size = len(kernel)
    high = ndimage.maximum_filter(np.where(known, values, -np.inf), size)
    low = ndimage.minimum_filter(np.where(known, values, np.inf), size)
    total, weight = np.where(known, values, 0.0), known.astype(np.float64)
    for axis in (0, 1):
        total = ndimage.correlate1d(total, kernel, axis=axis, mode="constant")
        weight = ndimage.correlate1d(weight, kernel, axis=axis, mode="constant")
    smooth = known & (high - low <= most_range)
    mean = np.divide(total, weight, out=np.array(values), where=smooth)
    return np.asarray(mean, dtype=np.float64)


def on_edges(depth: FloatArray, most_step: FloatArray) -> BoolArray:
    """Says which pixels have nothing beside them, or another surface.

    Args:
        depth: (H, W), NaN where nothing is.
        most_step: (H, W), a larger difference to one of the eight pixels around is a jump.

    Returns:
        (H, W), False where ``depth`` is NaN; the rim of the image is no edge.

    Example:
        >>> on_edges(np.array([[1.0, 1, 1, 2, np.nan]]), np.full((1, 5), 0.5)).tolist()
        [[False, False, True, True, False]]
    """
    filled = np.where(np.isfinite(depth), depth, np.inf)
    high = ndimage.maximum_filter(filled, 3, mode="nearest")
    low = ndimage.minimum_filter(filled, 3, mode="nearest")
    known = np.isfinite(depth)
    edge = np.zeros(depth.shape, dtype=bool)
    edge[known] = (high[known] - depth[known] > most_step[known]) | (
        depth[known] - low[known] > most_step[known]
    )
    return edge
