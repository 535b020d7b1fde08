"""One run of a method on one mesh: what every method does before and after its own work."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
import trimesh  # noqa: F401  what reads meshes takes a second to import: before a run, which must stop sooner than that
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.controls import Controls
from gcnd.errors import MeshWarning
from gcnd.forks import refuse_fork
from gcnd.memory import BYTES_A_FACE, check_memory
from gcnd.mesh_io import FILE_WARNINGS, MeshArrays, load, to_arrays
from gcnd.report import make_report
from gcnd.spikes import Spikes
from gcnd.stages import Progress, Stages
from gcnd.start import Start
from gcnd.surface import Surface, as_surface

__all__ = ["Denoised", "Method", "Moved", "run_on"]


class Moved(NamedTuple):
    """What a method's own work gives.

    Attributes:
        vertices: Positions (V', 3), mesh units.
        confidence: By face of the surface (F',), 0 to 1, or None.
        described: What there is to say of the method once it has seen the mesh, as JSON-ready values.
    """

    vertices: NDArray[np.float64]
    confidence: NDArray[np.float64] | None = None
    described: Mapping[str, Any] = MappingProxyType({})


Move = Callable[[Surface, Start, Stages], Moved]
"""Takes a mesh with each position once, (V', 3), and where its work starts, and says where its vertices go."""


@dataclass(frozen=True, eq=False)
class Denoised:
    """Holds what a run found.

    Attributes:
        mesh: The clean mesh, of the same kind as the input; a ``trimesh.Trimesh`` for a path.
        confidence: How far overlapping predictions for each face agree (F,), 0 to 1; None where there are none.
        before: The input's vertices (V, 3) and faces (F, 3).
        after: The vertices (V, 3) that ``mesh`` has, float64.
        seconds: Wall-clock seconds by stage.
        method: What ran, as JSON-ready values.
        warnings: What is wrong with the mesh, in sentences.
        spikes: That were taken off for the work; None where the method keeps them.
    """

    mesh: Any
    confidence: NDArray[np.float64] | None
    before: MeshArrays
    after: NDArray[np.float64]
    seconds: dict[str, float]
    method: dict[str, Any]
    warnings: tuple[str, ...] = ()
    spikes: Spikes | None = None

    def report(self) -> dict[str, Any]:
        """Returns what ran, how long it took and what it changed, as JSON-ready values; see ``gcnd.report``."""
        report = make_report(self.before, self.after, self.method, self.seconds, self.spikes)
        return {**report, "warnings": list(self.warnings)}


class Method(Protocol):
    """Anything with a ``run`` on one mesh: ``gcnd.Denoiser``, ``gcnd.filters.Filter``.

    Attributes:
        triangulate: Whether faces of four corners and more are split for the work.
    """

    triangulate: bool

    def run(self, mesh: Any, *, progress: Progress | None = None) -> Denoised:
        """Denoises one mesh."""
        ...


def run_on(
    mesh: Any,
    move: Move,
    controls: Controls,
    method: dict[str, Any],
    progress: Progress | None = None,
    triangulate: bool = False,
    *,
    takes_spikes_off: bool = False,
    bytes_a_face: Callable[[int], int] = lambda n_faces: BYTES_A_FACE,
) -> Denoised:
    """Takes a mesh apart, has its vertices moved, applies the controls, and puts it together again.

    Args:
        mesh: Whatever ``to_arrays`` takes.
        move: The method's own work.
        controls: How much of it is wanted.
        method: What runs, for the report.
        progress: Told how far the run has come; returning False cancels.
        triangulate: Whether faces of four corners and more are split for the work.
        takes_spikes_off: Whether the work starts without spikes; see ``gcnd.start``.
        bytes_a_face: What the method takes for each of so many faces; see ``gcnd.memory``.

    Raises:
        GcndError: This process is a fork, see ``gcnd.forks``.
        MeshError: The mesh cannot be worked on.
        ConfigError: A control does not fit the mesh.
        Cancelled: ``progress`` said so.

    Warns:
        MeshWarning: Faces are repeated, disagree on which side is out, have no area, or most have hardly a
            neighbourhood, see ``gcnd.surface``; or there are spikes, see ``gcnd.spikes``.
    """
    refuse_fork()
    stages = Stages(progress)
    stages(0.0, "reading")
    if isinstance(mesh, str | os.PathLike):
        mesh = load(mesh, triangulate=triangulate)
    arrays, rebuild = to_arrays(mesh, triangulate=triangulate)
    _geom.validate(arrays.vertices, arrays.faces)
    check_memory(len(arrays.vertices), len(arrays.faces), bytes_a_face(len(arrays.faces)))
    stages.ask()
    mesh_once, finish = controls.bind(mesh, arrays, stages.ask)
    stages(0.0, "adjacency")
    surface = as_surface(mesh_once)
    start = Start(surface.topology, surface.mesh.vertices, takes_spikes_off=takes_spikes_off)
    told_by_file = _told_by_file(mesh)
    told = surface.told + (start.spikes.told() if start.spikes else ())
    for sentence in told:
        # Seen from here: the method's run, what called it, and the caller's own line.
        warnings.warn(sentence, MeshWarning, stacklevel=4)
    stages.ask()
    moved = move(surface, start, stages)
    stages(1.0, "finishing")
    after = finish(moved.vertices)
    stages.ask()
    result = rebuild(after)
    stages(1.0, "done")
    described = {**method, **moved.described, "controls": controls.described()}
    confidence = None if moved.confidence is None else surface.of_all_faces(moved.confidence)
    return Denoised(
        result, confidence, arrays, after, stages.seconds, described, told_by_file + told, start.spikes
    )


def _told_by_file(mesh: Any) -> tuple[str, ...]:
    """What `load` has warned of already."""
    metadata = getattr(mesh, "metadata", None)
    told = metadata.get(FILE_WARNINGS) if isinstance(metadata, dict) else None
    return tuple(map(str, told)) if isinstance(told, list) else ()
