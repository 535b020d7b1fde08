"""What is done to any machine part: bevels, bores, grooves, cuts, additions and a bend."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from manifold3d import Manifold

from gcnd.data.shapes_profiles import circle, segments
from gcnd.data.shapes_solids import primitive, triple, turned


def trimmed(rng: np.random.Generator, solid: Manifold) -> Manifold:
    """Return a solid with a corner or an edge cut off by a plane.

    Example:
        >>> import numpy as np
        >>> 0 < trimmed(np.random.default_rng(0), Manifold.cube()).volume() < 1
        True
    """
    box = np.array(solid.bounding_box())
    half = 0.5 * (box[3:] - box[:3])
    normal = np.sign(rng.standard_normal(3)) * rng.uniform(0.2, 1.0, 3)
    if rng.random() < 0.5:
        normal[int(rng.integers(3))] = 0.0
    normal /= np.linalg.norm(normal)
    reach = float(np.abs(normal) @ half)
    offset = float(normal @ (0.5 * (box[:3] + box[3:]))) + reach * float(rng.uniform(0.6, 0.9))
    return solid.trim_by_plane(triple(-normal), -offset)


def _bored(rng: np.random.Generator, solid: Manifold) -> Manifold:
    """Drill a round, square or countersunk hole."""
    r = float(rng.uniform(0.03, 0.12))
    hole = Manifold.cylinder(3.0, r, r, segments(r), True)
    if rng.random() < 0.3:
        hole = Manifold.cube((1.6 * r, 1.6 * r, 3.0), True)
    elif rng.random() < 0.3:
        hole += Manifold.cylinder(0.6, 0.0, 4 * r, segments(2 * r)).translate((0.0, 0.0, 0.1))
    return solid - turned(rng, hole).translate(triple(rng.uniform(-0.25, 0.25, 3)))


def _grooved(rng: np.random.Generator, solid: Manifold) -> Manifold:
    """Engrave shallow parallel, crossing or ring-shaped grooves into the top, like lettering."""
    top = float(solid.bounding_box()[5])
    depth, width = float(rng.uniform(0.01, 0.04)), float(rng.uniform(0.015, 0.05))
    tools = []
    for i in range(int(rng.integers(2, 7))):
        if rng.random() < 0.25:
            r = float(rng.uniform(0.08, 0.3))
            ring = (circle(r + width) - circle(r)).extrude(2 * depth)
            tools.append(ring.translate((0.0, 0.0, -depth)))
        else:
            bar = Manifold.cube((float(rng.uniform(0.1, 0.8)), width, 2 * depth), True)
            bar = bar.rotate((0.0, 0.0, float(rng.choice([0.0, 90.0, 45.0]))))
            tools.append(bar.translate((float(rng.uniform(-0.2, 0.2)), (i - 2.5) * 3 * width, 0.0)))
    tool = tools[0]
    for other in tools[1:]:
        tool += other
    return solid - tool.translate((0.0, 0.0, top))


def _cut(rng: np.random.Generator, solid: Manifold) -> Manifold:
    return solid - turned(rng, primitive(rng)).translate(triple(rng.uniform(-0.6, 0.6, 3)))


def _joined(rng: np.random.Generator, solid: Manifold) -> Manifold:
    other = turned(rng, primitive(rng)).scale((0.7, 0.7, 0.7))
    return solid + other.translate(triple(rng.uniform(-0.3, 0.3, 3)))


FEATURES: tuple[tuple[Callable[[np.random.Generator, Manifold], Manifold], float], ...] = (
    (_joined, 0.2),
    (_cut, 0.35),
    (trimmed, 0.35),
    (_bored, 0.4),
    (_grooved, 0.3),
)
"""Each feature with the chance that a part gets it."""


def bent(rng: np.random.Generator, solid: Manifold) -> Manifold:
    """Return a solid gently bent and tapered: edges and faces become curved, and edges stay sharp.

    Example:
        >>> import numpy as np
        >>> bent(np.random.default_rng(0), Manifold.cube((1.0, 1.0, 1.0), True)).genus()
        0
    """
    fine = solid.refine_to_length(0.02)
    bend, taper = float(rng.uniform(-1.0, 1.0)), float(rng.uniform(-0.3, 0.3))
    axis = int(rng.integers(3))

    def warp(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        p = np.roll(np.array(points), axis, axis=1)
        scale = 1 + taper * p[:, 2]
        x, y = p[:, 0] * scale, p[:, 1] * scale
        angle = bend * p[:, 2]
        reach = (1 / bend + x) if abs(bend) > 0.1 else x
        bent = np.stack([reach * np.cos(angle) - 1 / bend, y, reach * np.sin(angle)], axis=1)
        result = bent if abs(bend) > 0.1 else np.stack([x, y, p[:, 2]], axis=1)
        return np.ascontiguousarray(np.roll(result, -axis, axis=1))

    return fine.warp_batch(warp)
