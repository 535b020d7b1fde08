"""Building blocks of procedural machine parts: primitives, and moving solids about."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from manifold3d import CrossSection, Manifold

from gcnd.data.shapes_profiles import ball_segments, circle, polygon, segments


def largest_piece(solid: Manifold) -> Manifold:
    """Return the connected piece of largest volume.

    Example:
        >>> two = Manifold.cube() + Manifold.cube((2.0, 2.0, 2.0)).translate((5.0, 0.0, 0.0))
        >>> largest_piece(two).volume()
        8.0
    """
    pieces = solid.decompose()
    return max(pieces, key=lambda piece: piece.volume()) if pieces else solid


def fitted(solid: Manifold) -> Manifold:
    """Return a solid moved to the origin and scaled so that its longest side is 1.

    Example:
        >>> fitted(Manifold.cube((2.0, 4.0, 1.0))).bounding_box()
        (-0.25, -0.5, -0.125, 0.25, 0.5, 0.125)
    """
    box = np.array(solid.bounding_box())
    size = float((box[3:] - box[:3]).max())
    centre = 0.5 * (box[:3] + box[3:])
    moved = solid.translate((float(-centre[0]), float(-centre[1]), float(-centre[2])))
    return moved.scale((1 / size, 1 / size, 1 / size)) if size > 0 else moved


def triple(values: npt.NDArray[np.floating]) -> tuple[float, float, float]:
    """Return three numbers as manifold3d wants them.

    Example:
        >>> import numpy as np
        >>> triple(np.array([1.0, 2.0, 3.0]))
        (1.0, 2.0, 3.0)
    """
    return float(values[0]), float(values[1]), float(values[2])


def turned(rng: np.random.Generator, solid: Manifold) -> Manifold:
    """Return a solid rotated about the origin: by right angles mostly, freely at times.

    Example:
        >>> import numpy as np
        >>> round(turned(np.random.default_rng(0), Manifold.cube()).volume(), 6)
        1.0
    """
    if rng.random() < 0.6:
        return solid.rotate(triple(90.0 * rng.integers(0, 4, 3)))
    return solid.rotate(triple(rng.uniform(0, 360, 3)))


def primitive(rng: np.random.Generator) -> Manifold:
    """Return a box, cylinder, cone, ball, torus, prism or gem, 0.2 to 0.8 across.

    Example:
        >>> import numpy as np
        >>> primitive(np.random.default_rng(0)).volume() > 0
        True
    """
    choice = int(rng.integers(7))
    r, h = (float(x) for x in rng.uniform(0.12, 0.4, 2))
    if choice == 0:
        return Manifold.cube(triple(rng.uniform(0.2, 0.8, 3)), True)
    if choice == 1:
        return Manifold.cylinder(2 * h, r, r, segments(r), True)
    if choice == 2:
        return Manifold.cylinder(2 * h, r, r * float(rng.uniform(0, 0.6)), segments(r), True)
    if choice == 3:
        return Manifold.sphere(r, ball_segments(r))
    if choice == 4:
        tube = circle(float(rng.uniform(0.25, 0.6)) * r).translate((r, 0.0))
        return tube.revolve(segments(r))
    if choice == 5:
        return polygon(rng).scale((2 * r, 2 * r)).extrude(2 * h).translate((0.0, 0.0, -h))
    return polyhedron(rng).scale((0.6, 0.6, 0.6))


def polyhedron(rng: np.random.Generator) -> Manifold:
    """Return a gem: the convex hull of random points on an ellipsoid at most 1 across.

    Example:
        >>> import numpy as np
        >>> polyhedron(np.random.default_rng(0)).genus()
        0
    """
    points = rng.standard_normal((int(rng.integers(6, 26)), 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return Manifold.hull_points(points * rng.uniform(0.25, 0.5, 3))


def polygon_prism(corners: npt.NDArray[np.float64], height: float) -> Manifold:
    """Return the prism of height `height` over a polygon; (N, 2) corners anticlockwise, in part units.

    Example:
        >>> import numpy as np
        >>> polygon_prism(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), 2.0).volume()
        1.0
    """
    return CrossSection([corners]).extrude(height)
