"""Putting the page together: meshes and values as base64, style, shaders and scripts inside it."""

from __future__ import annotations

import base64
import html
import json
import math
from dataclasses import dataclass
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd.start import lengths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from gcnd.mesh_io import MeshArrays
    from gcnd.viewer.changes import Figures, Layer

__all__ = ["Names", "view_page"]

_UNKNOWN = 65535
"""Stands for NaN among values in 16 bits."""

_SCRIPTS = ("colors.js", "data.js", "surface.js", "camera.js", "controls.js", "main.js")


@dataclass(frozen=True)
class Names:
    """What the meshes are called on the page, plain text; `truth` is None without one."""

    before: str
    after: str
    truth: str | None = None


def view_page(
    before: MeshArrays, after: MeshArrays, layers: Sequence[Layer], figures: Figures, names: Names
) -> str:
    """Returns the page as HTML.

    Positions are float32 around the middle of both meshes in units of their radius, so that nothing is lost far from
    the origin; face indices are uint32, values uint16.

    Args:
        before: The mesh before.
        after: The same faces, moved.
        layers: What to colour by.
        figures: What to say in numbers.
        names: Of the meshes.
    """
    blobs, manifest = _data(before, after, layers)
    manifest |= {"before": names.before, "after": names.after}
    scripts = "".join(_text("scripts", name) for name in _SCRIPTS)
    title = f"{names.after} against {names.before}"
    return Template(_text("page.html")).substitute(
        title=html.escape(title),
        style=_text("page.css"),
        before=_tag("before", names.before),
        after=_tag("after", names.after),
        figures=_figure_tables(figures, names),
        layers="".join(
            f'<option value="{layer.name}">{html.escape(layer.label)}</option>' for layer in layers
        ),
        # Inside a script element only "<" could end it early.
        manifest=json.dumps(manifest).replace("<", "\\u003c"),
        blobs="".join(
            f'<script type="text/plain" id="{name}">{data}</script>' for name, data in blobs.items()
        ),
        vertex_shader=_text("shaders", "surface.vert"),
        fragment_shader=_text("shaders", "surface.frag"),
        three=_text("three", "three.min.js"),
        scripts=scripts,
    )


def _tag(when: str, name: str) -> str:
    """Text over a pane; a mesh that is not a file has no name but when it is."""
    return when if name == when else f"{when}: {html.escape(name)}"


def _text(*parts: str) -> str:
    return files("gcnd.viewer").joinpath(*parts).read_text(encoding="utf-8")


def _data(
    before: MeshArrays, after: MeshArrays, layers: Sequence[Layer]
) -> tuple[dict[str, str], dict[str, Any]]:
    """Blobs in base64 by element id, and what the program needs to know of them."""
    is_used = np.zeros(len(before.vertices), dtype=np.bool_)
    is_used[before.faces.reshape(-1)] = True
    # Vertices without a face are not shown, and must not push the view away from what is.
    shown = np.flatnonzero(is_used)
    new_id = np.cumsum(is_used, dtype=np.int64) - 1
    positions = [mesh.vertices[shown] for mesh in (before, after)]
    low, high = (f([f(own, axis=0) for own in positions], axis=0) for f in (np.min, np.max))
    middle = low + (high - low) / 2
    radius = max(float(lengths(own - middle).max()) for own in positions) or 1.0
    blobs = {
        "faces": _base64(new_id[before.faces].astype("<u4")),
        "positions-before": _base64(((positions[0] - middle) / radius).astype("<f4")),
        "positions-after": _base64(((positions[1] - middle) / radius).astype("<f4")),
    }
    entries = []
    for layer in layers:
        keep = shown if layer.per == "vertex" else slice(None)
        pair = (layer.before[keep], layer.after[keep])
        top = max((float(np.nanmax(own)) for own in pair if not np.isnan(own).all()), default=0.0) or 1.0
        blobs[f"{layer.name}-before"] = _base64(_in_16_bits(pair[0], top))
        if layer.after is not layer.before:
            blobs[f"{layer.name}-after"] = _base64(_in_16_bits(pair[1], top))
        entry = {"name": layer.name, "label": layer.label, "unit": layer.unit, "per": layer.per}
        has_unknown = bool(any(np.isnan(own).any() for own in pair))
        entries.append(entry | {"top": top, "scaleEnd": layer.scale_end, "hasUnknown": has_unknown})
    manifest = {"faces": len(before.faces), "vertices": len(shown), "layers": entries}
    return blobs, manifest


def _in_16_bits(values: NDArray[np.float64], top: float) -> NDArray[np.uint16]:
    """Values from 0 to `top` as 0 to 65534, NaN as 65535."""
    steps = np.rint(np.nan_to_num(values) / top * (_UNKNOWN - 1))
    return np.where(np.isnan(values), _UNKNOWN, steps).astype("<u2")


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _figure_tables(figures: Figures, names: Names) -> str:
    rows = [
        ("faces", f"{figures.faces:,}"),
        ("vertices", f"{figures.vertices:,}"),
        ("displacement, mean", _edges(figures.displacement_mean)),
        ("displacement, largest", _edges(figures.displacement_max)),
        ("angular change, mean", _degrees(figures.angle_mean)),
        ("angular change, largest", _degrees(figures.angle_max)),
        ("flipped (over 90°)", f"{figures.flipped:,}"),
    ]
    whole = "".join(f"<tr><th scope=row>{label}<td>{value}" for label, value in rows)
    tables = f"<table><caption>From before to after</caption>{whole}</table>"
    if figures.e_a_before is not None and figures.e_a_after is not None:
        rows3 = [
            ("E<sub>a</sub>", _degrees(figures.e_a_before), _degrees(figures.e_a_after)),
            ("flipped (over 90°)", f"{figures.flipped_before:,}", f"{figures.flipped_after:,}"),
        ]
        cells = "".join(f"<tr><th scope=row>{label}<td>{old}<td>{new}" for label, old, new in rows3)
        tables += (
            f"<table><caption>Against {html.escape(names.truth or 'the truth')}</caption>"
            f"<tr><td><th scope=col>before<th scope=col>after{cells}</table>"
        )
    return tables


def _edges(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:{'.3f' if value < 1e6 else '.3g'}} edges"


def _degrees(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f}°"
