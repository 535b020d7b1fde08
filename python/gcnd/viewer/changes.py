"""What changed between two meshes with the same faces: a value a face or a vertex to colour by, and figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from gcnd import _geom
from gcnd.start import lengths, mean_edge_length, near_1

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from gcnd.mesh_io import MeshArrays

__all__ = ["Figures", "Layer", "compare_meshes"]

_FLIPPED = 90.0
"""Degrees above which a face counts as flipped."""

_SHARE_IN_SCALE = 95.0
"""Percent of the values that the colour scale covers at first; the rest take its last colour."""

_SHARE_OF_BOTH_IN_SCALE = 75.0
"""The same for values of two meshes together: with all of the worse one in it, the better one would be one colour."""

_IN_EDGES = (1e-300, 1e300)
"""Displacements in mean edges: a smaller one is 0, and a larger one none, since sums and steps of a scale must be
numbers."""

_STEPS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


@dataclass(frozen=True)
class Layer:
    """Holds one value for every face or vertex, before and after.

    Attributes:
        name: As the page's program knows it.
        label: As people read it.
        unit: Behind a number, such as "°".
        per: What each value belongs to.
        before: Values (F,) or (V,) on the mesh before; NaN where there is none.
        after: Values on the mesh after; the same array where the value is one of the pair.
        scale_end: Value at the end of the colour scale, above 0.
    """

    name: str
    label: str
    unit: str
    per: Literal["face", "vertex"]
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    scale_end: float


@dataclass(frozen=True)
class Figures:
    """Holds what the page says in numbers.

    Lengths are in mean edge lengths of the mesh before, and NaN where all its edges are without length; angles in
    degrees between the normals of a face; a face without area before, or in the truth, has none. Figures against the
    truth are ``None`` without one.

    Attributes:
        faces: Number of faces.
        vertices: Number of vertices that a face uses; only these count below.
        mean_edge_length: Of the mesh before, mesh units.
        displacement_mean: Mean distance of a vertex before and after.
        displacement_max: The largest.
        angle_mean: Mean angle between a face's normals before and after; NaN where no face has one.
        angle_max: The largest.
        flipped: Faces whose normal turned by more than 90° from before to after.
        e_a_before: E_a of the mesh before against the truth.
        e_a_after: E_a of the mesh after.
        flipped_before: Faces more than 90° from the truth before.
        flipped_after: Faces more than 90° from the truth after.
    """

    faces: int
    vertices: int
    mean_edge_length: float
    displacement_mean: float
    displacement_max: float
    angle_mean: float
    angle_max: float
    flipped: int
    e_a_before: float | None = None
    e_a_after: float | None = None
    flipped_before: int | None = None
    flipped_after: int | None = None


def compare_meshes(
    before: MeshArrays,
    after: MeshArrays,
    truth: MeshArrays | None = None,
    confidence: NDArray[np.float64] | None = None,
) -> tuple[list[Layer], Figures]:
    """Computes what the page colours by and its figures.

    Args:
        before: The mesh before.
        after: The same faces, moved.
        truth: The same faces where they should be, or None.
        confidence: Of the denoising (F,), 0 to 1, or None.

    Returns:
        The layers angle (degrees, by face), with a truth error (degrees, by face), displacement (mean edge lengths, by
        vertex), and with a confidence doubt (1 − confidence in percent, by face); and the figures.

    Example:
        >>> from gcnd.mesh_io import to_arrays
        >>> corner, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]]
        >>> before, after = (to_arrays((v, faces))[0] for v in (corner, corner[:, [0, 2, 1]]))
        >>> layers, figures = compare_meshes(before, after)
        >>> round(figures.angle_max, 6), [layer.name for layer in layers]
        (90.0, ['angle', 'displacement'])
    """
    normals = [_normals(mesh) for mesh in (before, after)]
    angle = _geom.normal_angles(normals[1], normals[0])
    edge = mean_edge_length(before.vertices, before.faces)
    displacement = _in_edges(lengths(after.vertices - before.vertices), edge)
    counted = displacement[_used(before)]
    layers = [_layer("angle", "angular change", "°", "face", angle, angle)]
    against_truth: dict[str, float | int] = {}
    if truth is not None:
        errors = [_geom.normal_angles(own, _normals(truth)) for own in normals]
        layers.append(_layer("error", "error against truth", "°", "face", *errors))
        for when, values in zip(("before", "after"), errors, strict=True):
            against_truth[f"e_a_{when}"] = _known(values, np.mean)
            against_truth[f"flipped_{when}"] = int(np.count_nonzero(values > _FLIPPED))
    layers.append(_layer("displacement", "displacement", " edges", "vertex", displacement, displacement))
    if confidence is not None:
        doubt = 100 * (1 - confidence)
        layers.append(_layer("doubt", "doubt (1 − confidence)", " %", "face", doubt, doubt))
    figures = Figures(
        faces=len(before.faces),
        vertices=len(counted),
        mean_edge_length=edge,
        displacement_mean=_known(counted, np.mean),
        displacement_max=_known(counted, np.max),
        angle_mean=_known(angle, np.mean),
        angle_max=_known(angle, np.max),
        flipped=int(np.count_nonzero(angle > _FLIPPED)),
        **against_truth,  # type: ignore[arg-type]
    )
    return layers, figures


def _layer(
    name: str,
    label: str,
    unit: str,
    per: Literal["face", "vertex"],
    before: NDArray[np.float64],
    after: NDArray[np.float64],
) -> Layer:
    known = np.concatenate([values[~np.isnan(values)] for values in (before, after)])
    share = _SHARE_IN_SCALE if after is before else _SHARE_OF_BOTH_IN_SCALE
    top = float(np.percentile(known, share)) if len(known) else 0.0
    return Layer(name, label, unit, per, before, after, scale_end=_round_up(top))


def _round_up(value: float) -> float:
    """The next number that a scale can well end with; 1 for 0."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    # A hair of room, so that 5 stays 5 whatever the division makes of it.
    return float(next(step * power for step in _STEPS if value <= step * power * (1 + 1e-9)))


def _in_edges(ways: NDArray[np.float64], edge: float) -> NDArray[np.float64]:
    least, most = _IN_EDGES
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        shares = ways / edge
    return np.where((edge > 0.0) & (shares <= most), np.where(shares < least, 0.0, shares), np.nan)


def _normals(mesh: MeshArrays) -> NDArray[np.float64]:
    return _geom.face_geometry(near_1(mesh.vertices, mesh.faces)[0], mesh.faces)[0]


def _used(mesh: MeshArrays) -> NDArray[np.bool_]:
    is_used = np.zeros(len(mesh.vertices), dtype=np.bool_)
    is_used[mesh.faces.reshape(-1)] = True
    return is_used


def _known(values: NDArray[np.float64], sum_up: Callable[[NDArray[np.float64]], np.float64]) -> float:
    """What is made of the values that are known; NaN where none is."""
    known = values[~np.isnan(values)]
    return float(sum_up(known)) if len(known) else float("nan")
