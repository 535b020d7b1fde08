"""Pictures of one mesh as every method left it: one view, one error colour scale, and close-ups where they differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.metrics import normal_angles
from gcnd.page import data_uri
from gcnd.picture import Panel, render, view_matrix

if TYPE_CHECKING:
    from gcnd.compare.adapters.base import Faces, Vertices
    from gcnd.compare.cases import CaseMesh

__all__ = ["CasePictures", "Shot", "View", "choose_view", "draw_case", "scale_end"]

WHOLE_PIXELS, CLOSE_PIXELS = 440, 440

_VIEWS = [(azimuth, elevation) for elevation in (25.0, -20.0) for azimuth in (35.0, 125.0, 215.0, 305.0)]
_CELLS = 96
_CLOSE_CELLS = 22
_SCALE_ENDS = (5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0)


@dataclass(frozen=True)
class View:
    """Says from where and how near a mesh is drawn.

    Attributes:
        matrix: Rows right, up, towards the viewer (3, 3).
        whole: Centre x, centre y and half width that show the whole mesh, view frame.
        close: The same for the close-up.
    """

    matrix: NDArray[np.float64]
    whole: tuple[float, float, float]
    close: tuple[float, float, float]


@dataclass(frozen=True)
class Shot:
    """Holds the pictures of one result, each as the source of an ``img``.

    Attributes:
        title: What it is.
        e_a: Degrees; None for the truth.
        whole: The mesh, coloured by error.
        close: The close-up without colour.
        close_error: The close-up, coloured by error; empty for the truth.
    """

    title: str
    e_a: float | None
    whole: str
    close: str
    close_error: str


@dataclass(frozen=True)
class CasePictures:
    """Holds the pictures of one mesh.

    Attributes:
        shots: Of the input, the results and the truth.
        scale_end: Degrees at the end of the colour scale.
    """

    shots: list[Shot]
    scale_end: float


def draw_case(mesh: CaseMesh, results: Mapping[str, Vertices]) -> CasePictures:
    """Draws the input, every result and the truth.

    Args:
        mesh: Input and truth.
        results: Positions (V, 3) by title.

    Returns:
        Pictures in that order.
    """
    truth, faces = mesh.truth, mesh.faces
    angles = {title: normal_angles(vertices, truth, faces) for title, vertices in results.items()}
    noisy = normal_angles(mesh.noisy, truth, faces)
    among = [np.nan_to_num(one) for one in angles.values()] or [np.nan_to_num(noisy)]
    spread = np.ptp(among, axis=0) if len(among) > 1 else among[0]
    view = choose_view(truth, faces, spread)
    end = scale_end(among)
    shots = [_shot("noisy", mesh.noisy, faces, noisy, view, end)]
    shots += [_shot(title, results[title], faces, angles[title], view, end) for title in results]
    shots.append(_shot("truth", truth, faces, None, view, end))
    return CasePictures(shots, end)


def scale_end(angles: list[NDArray[np.float64]]) -> float:
    """Returns a round end of the colour scale, degrees, that 95 of 100 faces of the results stay below."""
    wanted = float(np.percentile(np.concatenate(angles), 95))
    return next((end for end in _SCALE_ENDS if end >= wanted), _SCALE_ENDS[-1])


def choose_view(vertices: Vertices, faces: Faces, interest: NDArray[np.float64]) -> View:
    """Finds the view, of a few around the mesh, and in it the window where the visible faces are most of interest.

    Args:
        vertices: Positions (V, 3).
        faces: Vertex ids (F, 3).
        interest: Of each face (F,), not negative; counts by the area that is seen of it.

    Returns:
        The view; the first one where nothing is of interest.
    """
    normals, centroids, areas = _geom.face_geometry(vertices, np.ascontiguousarray(faces))
    best: tuple[float, View] | None = None
    for azimuth, elevation in _VIEWS:
        matrix = view_matrix(azimuth, elevation)
        used = vertices[np.unique(faces)] @ matrix[:2].T
        low, high = used.min(axis=0), used.max(axis=0)
        middle, half = (low + high) / 2, float((high - low).max()) * 0.52 or 1.0
        facing = normals @ matrix[2]
        weight = interest * areas * np.clip(facing, 0.0, None)
        placed = (centroids @ matrix.T - [*middle, 0.0]) / half
        score, x, y = _busiest_window(placed, np.where(facing > 0, weight, 0.0), facing > 0)
        if best is None or score > best[0] * (1 + 1e-9):
            centre = middle + half * np.array([x, y])
            close = (float(centre[0]), float(centre[1]), half * _CLOSE_CELLS / _CELLS)
            best = score, View(matrix, (float(middle[0]), float(middle[1]), half), close)
    assert best is not None  # there is always a first view
    return best[1]


def _busiest_window(
    placed: NDArray[np.float64], weight: NDArray[np.float64], facing: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """The square of `_CLOSE_CELLS` cells with most visible weight: that weight, and its centre in [-1, 1]."""
    cells = np.clip(((placed[:, :2] + 1) / 2 * _CELLS).astype(int), 0, _CELLS - 1)
    flat = cells[:, 1] * _CELLS + cells[:, 0]
    front = np.full(_CELLS * _CELLS, -np.inf)
    np.maximum.at(front, flat[facing], placed[facing, 2])
    # A face a few cells behind the foremost of its cell is taken for hidden.
    seen = facing & (placed[:, 2] >= front[flat] - 6 * 2 / _CELLS)
    grid = np.bincount(flat[seen], weights=weight[seen], minlength=_CELLS * _CELLS).reshape(_CELLS, _CELLS)
    table = np.zeros((_CELLS + 1, _CELLS + 1))
    table[1:, 1:] = grid.cumsum(axis=0).cumsum(axis=1)
    n = _CLOSE_CELLS
    sums = table[n:, n:] - table[:-n, n:] - table[n:, :-n] + table[:-n, :-n]
    row, column = np.unravel_index(int(sums.argmax()), sums.shape)
    x, y = ((int(start) + n / 2) / _CELLS * 2 - 1 for start in (column, row))
    return float(sums[row, column]), x, y


def _shot(
    title: str, vertices: Vertices, faces: Faces, angles: NDArray[np.float64] | None, view: View, end: float
) -> Shot:
    def picture(values: NDArray[np.float64] | None, is_close: bool) -> str:
        window, pixels = (view.close, CLOSE_PIXELS) if is_close else (view.whole, WHOLE_PIXELS)
        panel = Panel(title, vertices, faces, None if values is None else np.nan_to_num(values))
        return data_uri(render(panel, view.matrix, window, max_value=end, pixels=pixels), "webp")

    return Shot(
        title,
        None if angles is None else float(np.nanmean(angles)),
        picture(angles, is_close=False),
        picture(None, is_close=True),
        "" if angles is None else picture(angles, is_close=True),
    )
