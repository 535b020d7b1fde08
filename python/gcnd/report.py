"""What a run did, in numbers that can be kept: versions, seconds, displacements, flipped faces, noise."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.formats.atomic import write_or_tell
from gcnd.mesh_io import MeshArrays
from gcnd.neighbors import sum_across_edges
from gcnd.repeats import without_repeats
from gcnd.spikes import Spikes
from gcnd.start import Start, lengths, mean_edge_length, near_1
from gcnd.surface import as_surface
from gcnd.volume import enclosed_volumes, open_edges

__all__ = ["flipped_faces", "level_of", "make_report", "noise_level", "write_report"]

Points = NDArray[np.float64]

_QUARTILE_AT_LEVEL_1 = 0.185
"""Quartile of the roughness over mean edge and level, of Gaussian noise along normals, measured 0.160 to 0.211."""


def make_report(
    before: MeshArrays,
    after: Points,
    method: Mapping[str, Any],
    seconds: Mapping[str, float],
    spikes: Spikes | None = None,
) -> dict[str, Any]:
    """Describes a run.

    Args:
        before: The input's vertices (V, 3), mesh units, and faces (F, 3).
        after: The result's vertices (V, 3).
        method: What ran, as JSON-ready values.
        seconds: By stage.
        spikes: That were taken off for the work, if they were.

    Returns:
        JSON-ready values:

        - ``versions``: of gcnd, torch, numpy and Python.
        - ``method``: as given.
        - ``mesh``: ``vertices``, ``faces``, ``mean_edge_length`` of the input, and ``volume_before`` and
          ``volume_after`` in cubic mesh units, None for meshes that are not closed.
        - ``seconds``: as given, rounded, and their ``total``.
        - ``displacement``: ``mean``, ``rms`` and ``max`` in mesh units, the same with ``_edges`` in mean edge lengths
          of the input, and ``moved_vertices``.
        - ``flipped_faces``: ``before`` and ``after``, see `flipped_faces`; ``turned``, faces whose normal is more than
          90° from where it was.
        - ``noise_level``: ``before`` and ``after``, see `noise_level`. This, the flipped faces and the volumes are of
          the mesh with repeated faces once, this and the flipped faces with those turned that disagree with the rest.
        - ``spikes``: ``inside`` and ``on_rim``, how many were taken off for the work; None where none was looked for.
    """
    welded, ids = before.welded()
    once, _ = without_repeats(welded)
    moved = np.empty_like(welded.vertices)
    moved[ids] = after
    ways = after - before.vertices
    edge = mean_edge_length(before.vertices, before.faces)
    sizes = _sizes(ways)
    in_edges = {f"{name}_edges": value / edge if edge else 0.0 for name, value in sizes.items()}
    return _known(
        {
            "versions": {
                **{name: version(name) for name in ("gcnd", "torch", "numpy")},
                "python": platform.python_version(),
            },
            "method": dict(method),
            "mesh": {
                "vertices": len(after),
                "faces": len(before.faces),
                "mean_edge_length": edge,
                **_volumes(once, moved),
            },
            "seconds": {
                **{stage: round(taken, 4) for stage, taken in seconds.items()},
                "total": round(sum(seconds.values()), 4),
            },
            "displacement": {
                **{name: float(value) for name, value in (sizes | in_edges).items()},
                "moved_vertices": int(np.count_nonzero(ways.any(axis=1))),
            },
            **_shape_changes(once, moved, spikes),
            "spikes": None if spikes is None else {"inside": spikes.n_inside, "on_rim": spikes.n_on_rim},
        }
    )


def _sizes(ways: Points) -> dict[str, float]:
    """Mean, root mean square and maximum of lengths of ways (V, 3), also where their squares would be no numbers."""
    far = lengths(ways)
    most = float(far.max(initial=0.0))
    rms = most * float(np.sqrt(((far / most) ** 2).mean())) if most else 0.0
    return {"mean": float(far.mean()), "rms": rms, "max": most}


def _known(values: dict[str, Any]) -> dict[str, Any]:
    """The values with None in place of numbers that JSON cannot hold: what left the range of numbers is not known."""

    def one(value: Any) -> Any:
        if isinstance(value, dict):
            return _known(value)
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {name: one(value) for name, value in values.items()}


def flipped_faces(topology: _geom.Topology, normals: Points) -> int:
    """Counts faces that are folded over: n_f · Σ n_g < 0 over the faces g across the edges of f.

    Faces at needle tips count as well; compare the counts before and after.

    Args:
        topology: Adjacency of the mesh.
        normals: Unit normals (F, 3), zero for faces without area.

    Returns:
        The number of faces.
    """
    sums = [sum_across_edges(topology, normals[:, axis]) for axis in range(3)]
    return int(np.count_nonzero((normals * np.stack(sums, axis=1)).sum(axis=1) < 0.0))


def noise_level(
    topology: _geom.Topology,
    vertices: Points,
    faces: NDArray[np.uint32],
    spikes: Spikes | None = None,
) -> float:
    """Estimates the noise of a mesh: standard deviation along the normals, in mean edge lengths.

    level = q / (0.185 ē), q the lower quartile of the mesh's roughness. Within 15 % for Gaussian noise of levels 0.1
    to 0.3 on generated shapes, too low above; fine detail counts as noise.

    Args:
        topology: Adjacency of the mesh.
        vertices: Positions (V, 3), mesh units.
        faces: Vertex ids (F, 3).
        spikes: Of this mesh, where they are known.

    Returns:
        The level, as ``gcnd noise --level`` has it; 0 for a mesh without edges.

    Choice: docs/choices.md#mesh-roughness.
    """
    positions = Start(topology, vertices, spikes=spikes).positions
    return level_of(_geom.mesh_roughness(topology, positions), _geom.mean_edge_length(positions, faces))


def level_of(roughness: NDArray[np.float64], edge: float) -> float:
    """Returns `noise_level` of a mesh whose roughness (4,) and mean edge length are known, in one unit."""
    return float(roughness[1]) / (_QUARTILE_AT_LEVEL_1 * edge) if edge else 0.0


def write_report(path: Path, report: Any) -> None:
    """Writes a report as JSON, whole or not at all.

    Args:
        path: Where to write; an existing file is replaced.
        report: JSON-ready values.

    Raises:
        GcndError: The file cannot be written.
    """
    text = json.dumps(report, indent=2, ensure_ascii=False) + "\n"
    # A byte of a file's name that is no UTF-8 becomes the escape that JSON has for it.
    write_or_tell(path, text)


def _volumes(before: MeshArrays, after: Points) -> dict[str, float | None]:
    if open_edges(before.faces):
        return {"volume_before": None, "volume_after": None}
    one_body = np.zeros(len(after), dtype=np.int64)
    is_used = np.isin(np.arange(len(after)), before.faces)[:, None]
    near, doublings = near_1(before.vertices, before.faces)
    origin = near[is_used[:, 0]].mean(axis=0)
    volumes = [
        enclosed_volumes(points - origin, before.faces, one_body)[0]
        for points in (near, np.ldexp(np.where(is_used, after, 0.0), doublings))
    ]
    with np.errstate(over="ignore"):  # in cubic mesh units it may be no number
        told = [float(np.ldexp(volume, -3 * doublings)) for volume in volumes]
    return {"volume_before": told[0], "volume_after": told[1]}


def _shape_changes(before: MeshArrays, after: Points, spikes: Spikes | None) -> dict[str, Any]:
    before, topology = as_surface(before)[:2]
    old, new = (_geom.face_geometry(points, before.faces)[0] for points in (before.vertices, after))
    return {
        "flipped_faces": {
            "before": flipped_faces(topology, old),
            "after": flipped_faces(topology, new),
            "turned": int(np.count_nonzero((old * new).sum(axis=1) < 0.0)),
        },
        "noise_level": {
            "before": noise_level(topology, before.vertices, before.faces, spikes),
            "after": noise_level(topology, after, before.faces),
        },
    }
