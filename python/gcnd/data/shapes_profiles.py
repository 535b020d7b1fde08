"""Flat outlines of machine parts: what the procedural solids are extruded and revolved from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from manifold3d import CrossSection, JoinType
from scipy.interpolate import CubicSpline

Points = npt.NDArray[np.float64]

FACET_LENGTH = 0.007
"""Longest facet of a curved outline, for parts about 1 across; finer than the triangles made later."""

FILLET_RANGE = (0.03, 0.09)
"""Radii of fillets and rounds, for parts about 1 across: wide enough for a few triangles across each."""


def segments(radius: float) -> int:
    """Return how many facets a circle needs so that remeshing sees it as round; `radius` in part units.

    Example:
        >>> segments(0.5), segments(0.01)
        (456, 48)
    """
    wanted = 2 * np.pi * radius / FACET_LENGTH
    return int(np.clip(8 * np.ceil(wanted / 8), 48, 512))


def outline(rng: np.random.Generator) -> CrossSection:
    """Return a random outline about 1 across, around the origin, in part units.

    Example:
        >>> import numpy as np
        >>> outline(np.random.default_rng(0)).area() > 0
        True
    """
    make = _OUTLINES[int(rng.integers(len(_OUTLINES)))]
    section = make(rng)
    if rng.random() < 0.4:
        radius = float(rng.uniform(*FILLET_RANGE))
        section = rounded(section, radius)
    return section


def rounded(section: CrossSection, radius: float) -> CrossSection:
    """Return an outline with fillets and rounds of a radius in its corners, itself where nothing would be left.

    Example:
        >>> round(rounded(rectangle(2.0, 2.0), 0.5).area(), 1)
        3.8
    """
    n = segments(radius)
    filled = section.offset(radius, JoinType.Round, 2.0, n).offset(-2 * radius, JoinType.Round, 2.0, n)
    result = filled.offset(radius, JoinType.Round, 2.0, n).simplify(1e-5)
    return section if result.is_empty() else result


def ball_segments(radius: float) -> int:
    """Return how many facets the equator of a ball gets: fewer than a circle, for a ball has their square.

    Example:
        >>> ball_segments(0.5)
        256
    """
    return int(np.clip(4 * np.ceil(2 * np.pi * radius / (4 * 1.3 * FACET_LENGTH)), 48, 256))


def circle(radius: float) -> CrossSection:
    """Return a disc around the origin; `radius` in part units.

    Example:
        >>> round(circle(1.0).area(), 2)
        3.14
    """
    return CrossSection.circle(radius, segments(radius))


def rectangle(width: float, height: float) -> CrossSection:
    """Return a rectangle around the origin; sides in part units.

    Example:
        >>> rectangle(2.0, 3.0).area()
        6.0
    """
    return CrossSection.square((width, height), True)


def polygon(rng: np.random.Generator) -> CrossSection:
    """Return a regular polygon of 3 to 9 corners with circumradius 0.5.

    Example:
        >>> import numpy as np
        >>> 3 <= polygon(np.random.default_rng(0)).num_vert() <= 9
        True
    """
    n_corners = int(rng.integers(3, 10))
    return CrossSection.circle(0.5, n_corners).rotate(float(rng.uniform(0, 360)))


def lathe_profile(rng: np.random.Generator) -> CrossSection:
    """Return the section of a turned part about 1 high, of which x >= 0 counts: steps, cones, rounds and grooves.

    Example:
        >>> import numpy as np
        >>> lathe_profile(np.random.default_rng(0)).bounds()[2] > 0.1
        True
    """
    if rng.random() < 0.4:
        return _vase(rng)
    n_steps = int(rng.integers(3, 8))
    rounding = float(rng.uniform(*FILLET_RANGE)) if rng.random() < 0.5 else 0.0
    heights = np.concatenate([[0.0], np.cumsum(rng.uniform(0.4, 1.6, n_steps))])
    heights /= heights[-1]
    radii = rng.uniform(0.12, 0.5, n_steps)
    points: list[tuple[float, float]] = [(0.0, 0.0)]
    for i, radius in enumerate(radii):
        taper = float(rng.uniform(0.6, 1.0)) if rng.random() < 0.3 else 1.0
        points += [(float(radius), float(heights[i])), (float(radius) * taper, float(heights[i + 1]))]
    points.append((0.0, 1.0))
    section = CrossSection([np.asarray(points)])
    for _ in range(int(rng.integers(0, 4))):
        groove = circle(float(rng.uniform(0.02, 0.08)))
        section -= groove.translate((float(rng.choice(radii)), float(rng.uniform(0.1, 0.9))))
    if rounding:
        # A mirrored copy keeps the axis from being rounded off.
        whole = section + section.mirror((1.0, 0.0))
        section = rounded(whole, rounding)
    if rng.random() < 0.5:
        bore = float(rng.uniform(0.04, 0.1))
        section -= rectangle(2 * bore, 3.0)
    return section


def _vase(rng: np.random.Generator) -> CrossSection:
    knots = int(rng.integers(4, 8))
    spline = CubicSpline(np.linspace(0, 1, knots), rng.uniform(0.12, 0.5, knots))
    height = np.linspace(0, 1, 160)
    radius = np.clip(spline(height), 0.08, 0.6)
    outer = np.concatenate([[[0.0, 0.0]], np.stack([radius, height], axis=1), [[0.0, 1.0]]])
    section = CrossSection([outer])
    if rng.random() < 0.5:
        wall = float(rng.uniform(0.025, 0.06))
        inner = np.stack([radius - wall, height], axis=1)[height > 2 * wall]
        inner = np.concatenate([[[0.0, inner[0, 1]]], inner, [[inner[-1, 0], 1.5], [0.0, 1.5]]])
        section -= CrossSection([inner])
    return section


def _star(rng: np.random.Generator) -> CrossSection:
    n_tips = int(rng.integers(4, 13))
    angle = np.arange(2 * n_tips) * np.pi / n_tips
    radius = np.where(np.arange(2 * n_tips) % 2 == 0, 0.5, 0.5 * rng.uniform(0.45, 0.85))
    return CrossSection([np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)])


def _gear(rng: np.random.Generator) -> CrossSection:
    n_teeth = int(rng.integers(8, 25))
    root = float(rng.uniform(0.36, 0.44))
    tip = float(rng.uniform(0.3, 0.6))
    pitch = 2 * np.pi / n_teeth
    offsets = np.array([0.0, 0.5 - 0.5 * tip, 0.5 + 0.5 * tip, 1.0]) * 0.6
    radius = np.tile([root, 0.5, 0.5, root], n_teeth)
    angle = (np.arange(n_teeth)[:, None] * pitch + offsets * pitch).reshape(-1)
    teeth = CrossSection([np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)])
    return (teeth + circle(root)) - circle(float(rng.uniform(0.06, 0.25)))


def _beam(rng: np.random.Generator) -> CrossSection:
    """An L, U, T, I or cross section."""
    wall = float(rng.uniform(0.1, 0.25))
    width, height = (float(x) for x in rng.uniform(0.6, 1.0, 2))
    upright = rectangle(wall, height)
    left = upright.translate((0.5 * (wall - width), 0.0))
    right = upright.translate((0.5 * (width - wall), 0.0))
    base = rectangle(width, wall).translate((0.0, 0.5 * (wall - height)))
    top = rectangle(width, wall).translate((0.0, 0.5 * (height - wall)))
    across = rectangle(width, wall)
    parts = [[left, base], [left, right, base], [upright, top], [upright, top, base], [upright, across]]
    chosen = parts[int(rng.integers(len(parts)))]
    return CrossSection.compose(chosen)


def _spline(rng: np.random.Generator) -> CrossSection:
    """A smooth closed curve, star-shaped around the origin."""
    knots = int(rng.integers(5, 12))
    radius = rng.uniform(0.25, 0.5, knots)
    spline = CubicSpline(
        np.linspace(0, 2 * np.pi, knots + 1), np.append(radius, radius[0]), bc_type="periodic"
    )
    angle = np.linspace(0, 2 * np.pi, 420, endpoint=False)
    r = np.clip(spline(angle), 0.1, 0.7)
    return CrossSection([np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)])


def _slot(rng: np.random.Generator) -> CrossSection:
    """Two discs and their common hull: a link or a cam, sometimes with bores."""
    big, small = float(rng.uniform(0.2, 0.35)), float(rng.uniform(0.1, 0.2))
    first, second = circle(big).translate((-0.3, 0.0)), circle(small).translate((0.35, 0.0))
    section = CrossSection.batch_hull([first, second])
    if rng.random() < 0.7:
        section -= circle(0.5 * big).translate((-0.3, 0.0))
        section -= circle(0.5 * small).translate((0.35, 0.0))
    return section


def _hull(rng: np.random.Generator) -> CrossSection:
    return CrossSection.hull_points(rng.uniform(-0.5, 0.5, (int(rng.integers(4, 10)), 2)))


def _rectangle(rng: np.random.Generator) -> CrossSection:
    return rectangle(float(rng.uniform(0.4, 1.0)), float(rng.uniform(0.4, 1.0)))


def _disc(rng: np.random.Generator) -> CrossSection:
    return circle(float(rng.uniform(0.3, 0.5)))


_OUTLINES: tuple[Callable[[np.random.Generator], CrossSection], ...] = (
    _rectangle,
    _disc,
    polygon,
    _star,
    _gear,
    _beam,
    _spline,
    _slot,
    _hull,
)
