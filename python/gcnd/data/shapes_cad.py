"""Procedural machine parts: solids joined to and cut from each other, with the features CAD models have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import CrossSection, Manifold, OpType

from gcnd.data.shapes_cad_features import FEATURES, bent, trimmed
from gcnd.data.shapes_profiles import (
    FILLET_RANGE,
    ball_segments,
    circle,
    lathe_profile,
    outline,
    rectangle,
    rounded,
    segments,
)
from gcnd.data.shapes_solids import (
    fitted,
    largest_piece,
    polygon_prism,
    polyhedron,
    primitive,
    triple,
    turned,
)

Part = Callable[[np.random.Generator], Manifold]


def cad_solid(rng: np.random.Generator) -> tuple[str, Manifold]:
    """Return a random machine part, its family's name first.

    A family gives the body; holes, grooves, bevels, bosses, cutters and a bend are then added by chance. Curved
    faces have facets of at most a few degrees.

    Args:
        rng: Draws everything; the same state gives the same part.

    Returns:
        The name and a closed solid, its largest piece if cutting left several, about 1 across.

    Example:
        >>> import numpy as np
        >>> name, solid = cad_solid(np.random.default_rng(0))
        >>> solid.volume() > 0
        True
    """
    names = list(FAMILIES)
    name = names[int(rng.choice(len(names), p=_SHARES))]
    solid = fitted(FAMILIES[name](rng))
    for feature, chance in FEATURES:
        while rng.random() < chance:
            changed = feature(rng, solid)
            # A cut that eats the part is no feature.
            if not changed.is_empty() and changed.volume() > 0.4 * solid.volume():
                solid = changed
            chance *= 0.4
    solid = largest_piece(solid)
    if rng.random() < 0.25:
        solid = bent(rng, solid)
    return name, solid


def _assembly(rng: np.random.Generator) -> Manifold:
    solid = primitive(rng)
    for _ in range(int(rng.integers(2, 6))):
        solid += turned(rng, primitive(rng)).translate(triple(rng.uniform(-0.3, 0.3, 3)))
    for _ in range(int(rng.integers(1, 4))):
        solid -= turned(rng, primitive(rng)).translate(triple(rng.uniform(-0.45, 0.45, 3)))
    return solid


def _extrusion(rng: np.random.Generator) -> Manifold:
    height = float(rng.uniform(0.15, 0.9))
    twist = float(rng.uniform(-90, 90)) if rng.random() < 0.25 else 0.0
    scale = float(rng.uniform(0.4, 1.0)) if rng.random() < 0.25 else 1.0
    steps = 120 if twist else 0
    return outline(rng).extrude(height, steps, twist, (scale, scale))


def _turned_part(rng: np.random.Generator) -> Manifold:
    solid = lathe_profile(rng).revolve(segments(0.5))
    if rng.random() < 0.4:
        n_holes = int(rng.integers(3, 9))
        r = float(rng.uniform(0.02, 0.05))
        hole = Manifold.cylinder(4.0, r, r, segments(r), True).translate(
            (float(rng.uniform(0.2, 0.4)), 0.0, 0.0)
        )
        solid -= Manifold.batch_boolean(
            [hole.rotate((0.0, 0.0, 360.0 * i / n_holes)) for i in range(n_holes)], OpType.Add
        )
    return solid


def _plate(rng: np.random.Generator) -> Manifold:
    """A plate with an array of holes, pockets, bosses and ribs."""
    thick = float(rng.uniform(0.06, 0.2))
    plate = outline(rng).extrude(thick)
    nx, ny = (int(x) for x in rng.integers(1, 5, 2))
    r = float(rng.uniform(0.02, 0.05))
    drill = Manifold.cylinder(1.0, r, r, segments(r), True)
    for x in np.linspace(-0.3, 0.3, nx):
        for y in np.linspace(-0.3, 0.3, ny):
            plate -= drill.translate((float(x), float(y), 0.0))
    for _ in range(int(rng.integers(0, 4))):
        x, y = (float(x) for x in rng.uniform(-0.3, 0.3, 2))
        tall = float(rng.uniform(1.2, 3.0)) * thick
        r = float(rng.uniform(0.04, 0.1))
        boss = Manifold.cylinder(tall, r, float(rng.uniform(0.7, 1.0)) * r, segments(r))
        plate += boss.translate((x, y, 0.0))
        if rng.random() < 0.6:
            plate -= Manifold.cylinder(2.0, 0.5 * r, 0.5 * r, segments(0.5 * r), True).translate((x, y, 0.0))
    for _ in range(int(rng.integers(0, 3))):
        rib = Manifold.cube((0.8, float(rng.uniform(0.03, 0.07)), 2 * thick), True)
        plate += rib.rotate((0.0, 0.0, float(rng.choice([0.0, 90.0, 45.0])))).translate((0.0, 0.0, thick))
    return plate


def _bracket(rng: np.random.Generator) -> Manifold:
    """Two flanges with a fillet in between, gussets and bores."""
    t, w, tall = (float(x) for x in rng.uniform([0.06, 0.3, 0.4], [0.18, 1.0, 1.0]))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, t], [t, t], [t, tall], [0.0, tall]])
    profile = CrossSection([corners])
    if rng.random() < 0.6:
        profile = rounded(profile, max(float(rng.uniform(0.25, 0.45)) * t, FILLET_RANGE[0]))
    solid = profile.extrude(w).rotate((90.0, 0.0, 0.0)).translate((0.0, w, 0.0))
    reach = float(rng.uniform(0.25, 0.8)) * min(1.0, tall)
    gusset = polygon_prism(np.array([[0.0, 0.0], [reach, 0.0], [0.0, reach]]), 0.6 * t)
    for place in rng.uniform(0.1, 0.9, int(rng.integers(0, 4))):
        shift = (0.9 * t, float(place) * w + 0.3 * t, 0.9 * t)
        solid += gusset.rotate((90.0, 0.0, 0.0)).translate(shift)
    for _ in range(int(rng.integers(1, 6))):
        r = float(rng.uniform(0.03, 0.1))
        bore = Manifold.cylinder(3.0, r, r, segments(r), True)
        if rng.random() < 0.4:
            bore = bore.rotate((0.0, 90.0, 0.0)).translate((0.0, 0.0, tall * float(rng.uniform(0.4, 0.8))))
        else:
            bore = bore.translate((float(rng.uniform(0.4, 0.85)), 0.0, 0.0))
        solid -= bore.translate((0.0, w * float(rng.uniform(0.2, 0.8)), 0.0))
    return solid


def _pipe(rng: np.random.Generator) -> Manifold:
    """Bends and straights of one pipe with flanges between them."""
    r = float(rng.uniform(0.06, 0.14))
    bore = r * float(rng.uniform(0.5, 0.85))
    outer, inner = [], []
    frame = np.eye(4)[:3]
    for _ in range(int(rng.integers(2, 5))):
        if rng.random() < 0.5:
            length = float(rng.uniform(0.15, 0.5))
            piece = Manifold.cylinder(length, r, r, segments(r))
            hollow = Manifold.cylinder(length + 0.02, bore, bore, segments(bore)).translate((0.0, 0.0, -0.01))
            onward = np.eye(4)
            onward[2, 3] = length
            if rng.random() < 0.5:
                wide = r * float(rng.uniform(1.3, 1.8))
                piece += Manifold.cylinder(0.06, wide, wide, segments(wide)).translate(
                    (0.0, 0.0, 0.5 * length)
                )
        else:
            angle, radius = float(rng.uniform(30, 120)), r * float(rng.uniform(1.3, 2.5))
            ring = circle(r).translate((radius, 0.0)).revolve(segments(radius + r), angle)
            hole = circle(bore).translate((radius, 0.0)).revolve(segments(radius + r), angle)
            piece, hollow = (x.translate((-radius, 0.0, 0.0)).rotate((90.0, 0.0, 0.0)) for x in (ring, hole))
            turn = np.radians(angle)
            onward = np.eye(4)
            onward[:3, :3] = [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
            onward[:3, 3] = [radius * (np.cos(turn) - 1), 0.0, radius * np.sin(turn)]
        outer.append(piece.transform(frame))
        inner.append(hollow.transform(frame))
        spin = np.eye(4)
        a = rng.uniform(0, 2 * np.pi)
        spin[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
        frame = (np.vstack([frame, [0, 0, 0, 1]]) @ onward @ spin)[:3]
    solid = Manifold.batch_boolean(outer, OpType.Add)
    return solid - Manifold.batch_boolean(inner, OpType.Add) if rng.random() < 0.6 else solid


def _housing(rng: np.random.Generator) -> Manifold:
    """A thin-walled box or tub with openings."""
    wall = float(rng.uniform(0.03, 0.08))
    section = outline(rng)
    inner = section.offset(-wall)
    height = float(rng.uniform(0.3, 0.7))
    solid = section.extrude(height)
    if not inner.is_empty():
        solid -= inner.extrude(height).translate((0.0, 0.0, wall))
    for _ in range(int(rng.integers(0, 4))):
        r = float(rng.uniform(0.04, 0.12))
        bore = Manifold.cylinder(2.0, r, r, segments(r), True).rotate((90.0, 0.0, float(rng.uniform(0, 180))))
        solid -= bore.translate((0.0, 0.0, float(rng.uniform(0.3, 0.7)) * height))
    return solid


def _rounded(rng: np.random.Generator) -> Manifold:
    """A block with rounded edges: the hull of balls, cut by planes so that sharp edges meet blends."""
    radius = float(rng.uniform(0.05, 0.2))
    ball = Manifold.sphere(radius, ball_segments(radius))
    half = rng.uniform(0.1, 0.45, 3)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = signs * half + 0.3 * half * rng.standard_normal((8, 3)) * (rng.random() < 0.4)
    solid = Manifold.batch_hull([ball.translate(triple(c)) for c in corners])
    for _ in range(int(rng.integers(0, 3))):
        solid = trimmed(rng, solid)
    return solid


def _balls(rng: np.random.Generator) -> Manifold:
    """Balls joined and cut along sharp circles."""
    solid = Manifold.sphere(0.5, ball_segments(0.5))
    for _ in range(int(rng.integers(2, 7))):
        r = float(rng.uniform(0.15, 0.4))
        way = rng.standard_normal(3)
        ball = Manifold.sphere(r, ball_segments(r)).translate(
            triple(way / np.linalg.norm(way) * rng.uniform(0.4, 0.6))
        )
        solid = solid - ball if rng.random() < 0.6 else solid + ball
    return solid


def _stairs(rng: np.random.Generator) -> Manifold:
    """Blocks in shallow steps, straight or stacked."""
    n_steps = int(rng.integers(3, 9))
    rise = float(rng.uniform(0.02, 0.1))
    section = outline(rng)
    solid = section.extrude(rise)
    for i in range(1, n_steps):
        share = 1 - i / (n_steps + 1)
        level = section.scale((share, share)) if rng.random() < 0.7 else rectangle(0.9 * share, 0.9 * share)
        shift = (float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.05, 0.05)), i * rise - 0.5 * rise)
        solid += level.extrude(1.5 * rise).translate(shift)
    return solid


def _gem(rng: np.random.Generator) -> Manifold:
    solid = polyhedron(rng)
    return solid if rng.random() < 0.5 else solid + polyhedron(rng).rotate(triple(rng.uniform(0, 360, 3)))


FAMILIES: dict[str, Part] = {
    "assembly": _assembly,
    "extrusion": _extrusion,
    "turned": _turned_part,
    "plate": _plate,
    "bracket": _bracket,
    "pipe": _pipe,
    "housing": _housing,
    "rounded": _rounded,
    "balls": _balls,
    "stairs": _stairs,
    "gem": _gem,
}
"""The families of parts by name."""

_SHARES = np.array([0.16, 0.14, 0.15, 0.12, 0.07, 0.08, 0.07, 0.07, 0.06, 0.05, 0.03])
