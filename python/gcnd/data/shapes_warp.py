"""Bodies stretched and bent: other shapes with the same kind of detail."""

from __future__ import annotations

import numpy as np

from gcnd.data.noise import FloatArray

MOST_STRETCHED = 1.4
"""Largest stretch along an axis; the smallest is one over it."""

STEEPEST = 0.4
"""Largest slope of the bending, of its waves together: below 1, so that nothing is turned inside out."""

_WAVES = 3

_SHORTEST_WAVE = 0.5
"""Shortest wave of the bending over the diagonal of the box around the body."""


def stretched(vertices: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Stretch a body along three random axes at right angles, each by 1 / `MOST_STRETCHED` to `MOST_STRETCHED`.

    Planes stay planes, and edges stay edges at other angles.

    Args:
        vertices: (V, 3) float64.
        rng: What is drawn from.

    Returns:
        (V, 3) float64.

    Example:
        >>> stretched(np.eye(3), np.random.default_rng(0)).shape
        (3, 3)
    """
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    factors = MOST_STRETCHED ** rng.uniform(-1, 1, 3)
    return np.asarray(vertices @ (axes * factors) @ axes.T)


def bent(vertices: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Bend a body by a few long waves in random directions.

    p' = p + Σ_k a_k sin(ω_k · p + φ_k),  Σ_k ‖a_k‖ ‖ω_k‖ ≤ `STEEPEST`

    No wave is shorter than half the diagonal of the box around the body, so detail is carried along and hardly changed.

    Args:
        vertices: (V, 3) float64, not all in one place.
        rng: What is drawn from.

    Returns:
        (V, 3) float64.

    Example:
        >>> bent(np.eye(3), np.random.default_rng(0)).shape
        (3, 3)
    """
    diagonal = np.linalg.norm(np.ptp(vertices, axis=0))
    moved = np.array(vertices, dtype=np.float64)
    for _ in range(_WAVES):
        direction, push = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        frequency = 2 * np.pi / (diagonal * rng.uniform(_SHORTEST_WAVE, 2 * _SHORTEST_WAVE))
        steepness = STEEPEST / _WAVES * rng.uniform()
        phase = rng.uniform(0, 2 * np.pi)
        moved += np.sin(frequency * vertices @ direction + phase)[:, None] * push * (steepness / frequency)
    return moved
