"""Pictures of meshes without a display: matplotlib, orthographic, flat shading, coloured by a value a face."""

from __future__ import annotations

from dataclasses import dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from gcnd import _geom
from gcnd.errors import GcndError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

LIGHT = np.array([-0.35, 0.55, 0.75])
"""Direction to the light, view frame (x right, y up, z to the viewer)."""

CLAY = np.array([0.80, 0.78, 0.74])
"""Colour of a face without a value."""


@dataclass(frozen=True)
class Panel:
    """One picture of a mesh.

    Attributes:
        title: Text above it.
        vertices: (V, 3) float64.
        faces: (F, 3) uint32.
        values: Optional (F,) value to colour by, such as degrees of error.
    """

    title: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.uint32]
    values: NDArray[np.float64] | None = None


def save_panels(
    path: Path,
    rows: list[list[Panel]],
    *,
    azimuth: float = 35.0,
    elevation: float = 25.0,
    max_value: float = 30.0,
    label: str = "angular error, degrees",
    zoom: tuple[float, float, float] | None = None,
) -> None:
    """Draws rows of panels from one view into a PNG file.

    Args:
        path: File to write.
        rows: Panels by row; all show the same part of space.
        azimuth: Of the viewer around z, degrees.
        elevation: Of the viewer above the x-y plane, degrees.
        max_value: Value at the end of the colour scale.
        label: Of the colour scale.
        zoom: (x, y, width) of a close-up in fractions of the whole view; ``None`` shows all.

    Raises:
        GcndError: matplotlib is not installed.
    """
    try:
        from matplotlib import cm, colors
        from matplotlib.figure import Figure
    except ImportError as error:
        raise GcndError("pictures need matplotlib", hint="pip install 'gcnd[picture]'") from error
    view = view_matrix(azimuth, elevation)
    window = _window(rows[0][0], view, zoom)
    width = max(len(row) for row in rows)
    figure = Figure(figsize=(4.2 * width, 4.4 * len(rows)), dpi=130, layout="constrained")
    axes = figure.subplots(len(rows), width, squeeze=False)
    norm = colors.Normalize(0, max_value)
    for row, panels in enumerate(rows):
        for column in range(width):
            axes[row, column].set_axis_off()
            if column < len(panels):
                _draw(axes[row, column], panels[column], view, window, norm)
    if any(panel.values is not None for row in rows for panel in row):
        figure.colorbar(
            cm.ScalarMappable(norm, "viridis"), ax=axes, label=label, shrink=0.6, location="right"
        )
    figure.savefig(path, facecolor="white")


def render(
    panel: Panel,
    view: NDArray[np.float64],
    window: tuple[float, float, float],
    *,
    max_value: float = 30.0,
    pixels: int = 480,
    kind: str = "webp",
) -> bytes:
    """Draws one panel, without its title, into a square picture.

    Args:
        panel: What to draw.
        view: Rows right, up, towards the viewer; see `view_matrix`.
        window: Centre x, centre y and half width of what is shown, view frame.
        max_value: Value at the end of the colour scale.
        pixels: Width and height.
        kind: "webp" or "png".

    Returns:
        The file's bytes.

    Raises:
        GcndError: matplotlib is not installed.
    """
    try:
        from matplotlib import colors
        from matplotlib.figure import Figure
    except ImportError as error:
        raise GcndError("pictures need matplotlib", hint="pip install 'gcnd[picture]'") from error
    figure = Figure(figsize=(pixels / 100, pixels / 100), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    _draw(axes, replace(panel, title=""), view, window, colors.Normalize(0, max_value))
    data = BytesIO()
    options = {"quality": 88} if kind == "webp" else None
    figure.savefig(data, format=kind, facecolor="white", pil_kwargs=options)
    return data.getvalue()


def view_matrix(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Returns rows right, up, towards the viewer, in the mesh's frame, for angles in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.stack([right, np.cross(back, right), back])


def _window(
    panel: Panel, view: NDArray[np.float64], zoom: tuple[float, float, float] | None
) -> tuple[float, float, float]:
    """Centre x, centre y and half width of what is shown, view frame."""
    flat = panel.vertices @ view[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    half = float((high - low).max()) * 0.52
    x, y = ((low + high) / 2).tolist()
    if zoom is not None:
        x, y = (low + (high - low) * np.array(zoom[:2])).tolist()
        half *= zoom[2]
    return x, y, half


def _draw(
    axes: Axes, panel: Panel, view: NDArray[np.float64], window: tuple[float, float, float], norm: object
) -> None:
    from matplotlib import colormaps
    from matplotlib.collections import PolyCollection

    normals, centroids, _ = _geom.face_geometry(
        np.ascontiguousarray(panel.vertices), np.ascontiguousarray(panel.faces)
    )
    facing = normals @ view[2] > 0
    order = np.flatnonzero(facing)[np.argsort((centroids @ view[2])[facing])]
    if panel.values is None:
        base = np.broadcast_to(CLAY, (len(order), 3))
    else:
        base = colormaps["viridis"](norm(np.nan_to_num(panel.values[order])))[:, :3]  # type: ignore[operator]
    light = LIGHT / np.linalg.norm(LIGHT)
    # Colours stand for values, so light must not change them much.
    ambient = 0.35 if panel.values is None else 0.6
    shade = ambient + (1 - ambient) * np.clip((normals[order] @ view.T) @ light, 0, 1)
    triangles = (panel.vertices @ view[:2].T)[panel.faces[order]]
    fill = np.clip(base * shade[:, None], 0, 1)
    x, y, half = window
    low, high = triangles.min(axis=1) - (x, y), triangles.max(axis=1) - (x, y)
    inside = (high > -half).all(axis=1) & (low < half).all(axis=1)
    triangles, fill = triangles[inside], fill[inside]
    axes.add_collection(PolyCollection(triangles, facecolors=fill, edgecolors=fill, linewidths=0.5))
    axes.set_xlim(x - half, x + half)
    axes.set_ylim(y - half, y + half)
    axes.set_aspect("equal")
    axes.set_title(panel.title, fontsize=11, parse_math=False)
