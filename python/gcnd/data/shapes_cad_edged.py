"""Machine parts as they are drawn: extruded outlines whose edges are chamfered, filleted or stepped."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from manifold3d import CrossSection, Manifold, Mesh64, OpType

from gcnd.data.shapes_cad_features import bent, trimmed
from gcnd.data.shapes_profiles import circle, outline, rectangle, segments
from gcnd.data.shapes_solids import fitted, largest_piece

Points = npt.NDArray[np.float64]

_WIDTHS = (0.022, 0.08)
"""Of what is taken off an edge, for parts about 1 across: one triangle to a few across."""

_SHORTEST = 2e-4
"""What an outline may be off by to have fewer corners, in part units."""

_SHARPEST = 0.15
"""Where an outline turns back on itself, a mitre is cut short: 1 + the cosine of the turn."""


def edged_solid(rng: np.random.Generator) -> tuple[str, Manifold]:
    """Return a random plate, block or boss with holes and slots, edges chamfered, filleted or stepped.

    Args:
        rng: Draws everything; the same state gives the same part.

    Returns:
        "drawn" and a closed solid, its largest piece if cutting left several, about 1 across.

    Example:
        >>> import numpy as np
        >>> name, solid = edged_solid(np.random.default_rng(0))
        >>> solid.volume() > 0
        True
    """
    height = float(rng.uniform(0.08, 0.6))
    solid = _level(rng, _pierced(rng, outline(rng)), height)
    if rng.random() < 0.5:
        share = float(rng.uniform(0.3, 0.75))
        rise = float(rng.uniform(0.05, 0.4))
        upper = _level(rng, _pierced(rng, outline(rng)).scale((share, share)), rise + 0.01)
        shift = rng.uniform(-0.15, 0.15, 2)
        solid += upper.translate((float(shift[0]), float(shift[1]), height - 0.01))
    for _ in range(int(rng.integers(0, 3))):
        radius = float(rng.uniform(0.15, 0.4)) * height
        bore = Manifold.cylinder(3.0, radius, radius, segments(radius), True).rotate((90.0, 0.0, 0.0))
        bore = bore.rotate((0.0, 0.0, float(rng.choice([0.0, 90.0, rng.uniform(0, 180)]))))
        shift = rng.uniform(-0.3, 0.3, 2)
        solid -= bore.translate((float(shift[0]), float(shift[1]), 0.5 * height))
    solid = fitted(largest_piece(solid))
    if rng.random() < 0.3:
        solid = largest_piece(trimmed(rng, solid))
    if rng.random() < 0.15:
        solid = bent(rng, solid)
    return "drawn", solid


def _pierced(rng: np.random.Generator, section: CrossSection) -> CrossSection:
    """An outline with round and square holes and slots."""
    for _ in range(int(rng.integers(0, 5))):
        size = float(rng.uniform(0.04, 0.14))
        hole = circle(size)
        choice = rng.random()
        if choice < 0.2:
            hole = rectangle(1.8 * size, float(rng.uniform(1.0, 3.0)) * size)
        elif choice < 0.45:
            hole = rectangle(0.6 * size, 0.7).translate((0.0, 0.35))
        hole = hole.rotate(float(rng.choice([0.0, 90.0, 180.0, rng.uniform(0, 360)])))
        shift = rng.uniform(-0.35, 0.35, 2)
        section -= hole.translate((float(shift[0]), float(shift[1])))
    return section


def _level(rng: np.random.Generator, section: CrossSection, height: float) -> Manifold:
    """An extruded outline with one treatment of its upper edges and perhaps one of its lower."""
    solid = section.extrude(height)
    widest = min(_WIDTHS[1], 0.4 * height)
    if rng.random() < 0.97:
        solid -= edge_cutter(section, _edge_profile(rng, widest)).translate((0.0, 0.0, height))
    if rng.random() < 0.5:
        solid -= edge_cutter(section, _edge_profile(rng, widest)).mirror((0.0, 0.0, 1.0))
    return solid


def _edge_profile(rng: np.random.Generator, widest: float) -> Points:
    """(K, 2) of what is taken off an edge: how far inward of it, and how far above, anticlockwise."""
    width = float(np.exp(rng.uniform(np.log(_WIDTHS[0]), np.log(max(widest, 1.01 * _WIDTHS[0])))))
    depth = width * (float(rng.uniform(0.5, 2.0)) if rng.random() < 0.3 else 1.0)
    depth = min(depth, widest)
    beyond = 0.2 * width
    choice = rng.random()
    if choice < 0.6:
        slope = depth / width
        return np.array(
            [[width + beyond / slope, beyond], [-beyond, beyond], [-beyond, -depth - beyond * slope]]
        )
    if choice < 0.85:
        angle = np.linspace(np.pi, np.pi / 2, 13)
        arc = np.stack([width * (1 + np.cos(angle)), width * (np.sin(angle) - 1)], axis=1)
        return np.concatenate([[[width, beyond], [-beyond, beyond], [-beyond, -width]], arc])
    return np.array([[width, beyond], [-beyond, beyond], [-beyond, -depth], [width, -depth]])


def edge_cutter(section: CrossSection, profile: Points) -> Manifold:
    """Return what a cutter of a profile sweeps along the edges of an extruded outline, mitred at its corners.

    Args:
        section: The outline, in the plane z = 0 where the edges are.
        profile: (K, 2) anticlockwise, how far inward of the edge and how far above it, in part units.

    Returns:
        The solid to take away.

    Example:
        >>> chamfer = np.array([[0.4, 0.1], [-0.1, 0.1], [-0.1, -0.4]])
        >>> block = rectangle(2.0, 2.0).extrude(1.0)
        >>> cut = block - edge_cutter(rectangle(2.0, 2.0), chamfer).translate((0.0, 0.0, 1.0))
        >>> cut.num_vert(), round(4.0 - cut.volume(), 3)
        (12, 0.324)
    """
    swept = []
    for contour in section.simplify(_SHORTEST).to_polygons():
        corners = np.asarray(contour, dtype=np.float64)
        along = np.roll(corners, -1, axis=0) - corners
        inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        before = np.roll(inward, 1, axis=0)
        straight = np.maximum(1 + (before * inward).sum(axis=1), _SHARPEST)
        mitre = (before + inward) / straight[:, None]
        flat = corners[:, None] + profile[:, 0, None] * mitre[:, None]
        height = np.broadcast_to(profile[:, 1, None], (*flat.shape[:2], 1))
        n, k = flat.shape[:2]
        here = np.arange(n * k).reshape(n, k)
        there = np.roll(here, -1, axis=0)
        one, other = (np.stack([ids, np.roll(ids, -1, axis=1)], axis=-1) for ids in (here, there))
        quads = np.concatenate([one, other[..., ::-1]], axis=-1).reshape(-1, 4)
        triangles = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.uint64)
        points = np.concatenate([flat, height], axis=2).reshape(-1, 3)
        swept.append(Manifold(Mesh64(points, triangles)))
    return Manifold.batch_boolean(swept, OpType.Add)
