"""The straight line: a noisy mesh in, a clean mesh out (paper Fig. 2).

load → topology (once) → [patches → network → face normals → vertex update] per stage → refined normals at the
last → vertex update → vertices between normals and first positions → detail back where the noise is weak → save.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from gcnd import _geom
from gcnd.auto import AUTO
from gcnd.controls import Controls
from gcnd.errors import check_progress
from gcnd.passes import Pass, run_passes
from gcnd.predict import agreement, refined, settle_threads
from gcnd.stages import Progress, Stages
from gcnd.start import Start

if TYPE_CHECKING:
    import torch
    from numpy.typing import ArrayLike, NDArray

    from gcnd.nn.cascade import Cascade, CascadeConfig
    from gcnd.nn.fold import Precision


Boundary: TypeAlias = Literal["free", "along", "fixed"]
"""How vertices on a boundary move; see ``denoise``."""


def denoise(
    mesh: Any,
    *,
    preset: str = AUTO,
    device: torch.device | str = "cpu",
    seed: int = 0,
    normal_iterations: int | None = None,
    vertex_iterations: int | None = None,
    precision: Precision | None = None,
    boundary: Boundary = "along",
    triangulate: bool = False,
    strength: float = 1.0,
    max_displacement: float | None = None,
    max_displacement_edges: float | None = None,
    keep: ArrayLike | str | None = None,
    preserve_volume: bool = False,
    confidence: bool = False,
    progress: Progress | None = None,
) -> Any:
    """Removes noise from a triangle mesh and keeps its features.

    Faces and the order of vertices stay; only positions change. Vertices at exactly the same position, as STL
    files and texture seams repeat them, move together. The input is left as it is.

    Args:
        mesh: A mesh of trimesh, pyvista, open3d or meshio, a pair (vertices (V, 3), faces (F, 3)) of numpy or torch
            arrays, or a path; see ``gcnd.mesh_io.to_arrays``.
        preset: "auto" for "scan" where the mesh shows a camera's pixels, voxels or a printer's layer lines, see
            ``gcnd.auto``, and "default" otherwise; the name of shipped weights (``gcnd models`` lists them); or the
            path of a weights file.
        device: "cpu", or "cuda" where torch has it.
        seed: Chooses the patches that cover the mesh; the same seed gives the same result on the CPU.
        normal_iterations: m, iterations of normal refinement (Eq. 5) on every face after the last stage; 0 is none.
            The paper takes 12 for CAD models and depth-camera scans, 1 otherwise. ``None`` does what the preset
            says: ours refines where overlapping predictions allow it.
        vertex_iterations: Iterations of vertex updating (Eq. 6) after each stage; ``None`` takes the preset's: 60 for
            "scan", 15 for the others.
        precision: "float32" or "bfloat16" for the network's products; ``None`` takes the fastest that is measured safe
            on the device, see ``gcnd.predict.fast_precision``.
        boundary: How vertices on a boundary of an open mesh move: "along" the normal of the surface only, so that the
            outline stays; "free", like all others; "fixed", not at all. Closed meshes have none.
        triangulate: Whether faces of four corners and more are split for the work, see ``gcnd.mesh_io.load``; they are
            refused otherwise.
        strength: 0 keeps the input bit for bit, 1 is the full result; every vertex goes that share of its way.
        max_displacement: No vertex moves further, in mesh units.
        max_displacement_edges: The same in mean edge lengths; with both, the smaller counts.
        keep: Vertices left untouched bit for bit: booleans (V,), or the name of a vertex attribute that is not 0 there.
        preserve_volume: Whether closed bodies keep their volume; other meshes are refused.
        confidence: Whether to return as well how far overlapping predictions agree on each face.
        progress: Called now and then with (fraction done, what is being done); returning False cancels.

    Returns:
        The same kind as ``mesh`` (a ``trimesh.Trimesh`` for a path), with float64 positions or the input's dtype, and
        with all that the input has besides; with ``confidence``, that and an array (F,), 0 to 1.

    Raises:
        Cancelled: ``progress`` returned False; nothing has changed.
        MeshError: The mesh cannot be worked on: no faces, NaN, an index out of range, a file that is not a mesh.
        ConfigError: A parameter is out of range or the preset is unknown.
        WeightsError: The weights cannot be read or do not fit.

    Warns:
        MeshWarning: Faces are repeated, disagree on which side is out, have no area, or most have hardly a
            neighbourhood; or vertices are far off the surface.

    Paper: Secs. 3–6. Choice: docs/choices.md#boundary-vertices, docs/choices.md#orientation,
    docs/choices.md#repeated-faces, docs/choices.md#no-neighbourhood.

    Example:
        >>> import gcnd, trimesh
        >>> noisy = trimesh.creation.icosphere(subdivisions=3)
        >>> clean = gcnd.denoise(noisy)
        >>> bool((clean.faces == noisy.faces).all())
        True
    """
    from gcnd.denoiser import Denoiser  # which runs the line below

    check_progress(progress)
    denoiser = Denoiser(
        preset,
        device=device,
        seed=seed,
        normal_iterations=normal_iterations,
        vertex_iterations=vertex_iterations,
        precision=precision,
        boundary=boundary,
        triangulate=triangulate,
        controls=Controls(strength, max_displacement, max_displacement_edges, keep, preserve_volume),
    )
    if confidence:
        denoiser.check_confidence()
    done = denoiser.run(mesh, progress=progress)
    return (done.mesh, done.confidence) if confidence else done.mesh


class Cleaned(NamedTuple):
    """Denoised positions (V, 3), mesh units, and how far the last pass's predictions agree (F,), if they overlap."""

    vertices: NDArray[np.float64]
    confidence: NDArray[np.float64] | None


def denoise_arrays(
    vertices: NDArray[np.float64],
    faces: NDArray[np.uint32],
    cascade: Cascade,
    *,
    device: torch.device | str = "cpu",
    seed: int = 0,
    normal_iterations: int | None = None,
    vertex_iterations: int | None = None,
    precision: Precision | None = None,
    boundary: Boundary = "along",
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Runs a cascade over arrays and returns denoised positions (V, 3).

    Arguments as of ``clean_arrays``, with ``faces`` (F, 3); ``progress`` as of ``denoise``.
    """
    stages = Stages(progress)
    stages(0.0, "adjacency")
    topology = _geom.Topology(faces, len(vertices))
    cleaned = clean_arrays(
        Start(topology, vertices),
        topology,
        cascade,
        device=device,
        seed=seed,
        normal_iterations=normal_iterations,
        vertex_iterations=vertex_iterations,
        precision=precision,
        boundary=boundary,
        stages=stages,
    )
    stages(1.0, "done")
    return cleaned.vertices


def clean_arrays(
    start: Start,
    topology: _geom.Topology,
    cascade: Cascade,
    *,
    roughness: NDArray[np.float64] | None = None,
    device: torch.device | str,
    seed: int,
    normal_iterations: int | None,
    vertex_iterations: int | None,
    precision: Precision | None,
    boundary: Boundary,
    stages: Stages,
) -> Cleaned:
    """Runs a cascade over arrays; the line of ``denoise`` between reading and writing.

    Args:
        start: Positions to work from, mesh units, each once.
        topology: Adjacency of the mesh.
        cascade: Networks with what they expect of patches.
        roughness: Of ``start.positions`` (4,), as ``_geom.mesh_roughness`` gives it, where it is known.
        device: Where the cascade's weights are; the others as of ``denoise``.
        stages: Told how far the run has come.

    Returns:
        Denoised positions and the confidence.

    Paper: Fig. 2; Sec. 6 for what follows the last network.
    """
    settle_threads()
    config = cascade.config
    if vertex_iterations is not None:
        config = replace(config, vertex_iterations=vertex_iterations)
    if normal_iterations is not None:
        everywhere = replace(config.refinement, iterations=normal_iterations, tolerance=None, flat_only=False)
        config = replace(config, refinement=everywhere)
    passes = run_passes(
        topology,
        start.positions,
        cascade,
        roughness=roughness,
        device=device,
        seed=seed,
        precision=precision,
        vertex_iterations=config.vertex_iterations,
        boundary=boundary,
        stages=stages,
    )
    last = deque(passes, maxlen=1).pop()
    vertices = _moved(topology, start.positions, last, config, boundary, stages)
    overlaps = last.stage.coverage is not None
    confidence = agreement(topology, last.prediction.spread) if overlaps else None
    return Cleaned(start.way_back(vertices), confidence)


def _moved(
    topology: _geom.Topology,
    first: NDArray[np.float64],
    last: Pass,
    config: CascadeConfig,
    boundary: Literal["free", "along", "fixed"],
    stages: Stages,
) -> NDArray[np.float64]:
    """Positions (V, 3) after the last pass (paper Sec. 6): normals refined, vertices moved to them, detail back."""
    iterations = config.vertex_iterations
    normals = refined(topology, last.vertices, last.prediction, config.refinement, stages.ask)
    vertices = _geom.update_vertices(
        topology, last.vertices, normals, iterations, boundary, progress=stages.ask
    )
    if config.pull is not None and iterations:
        vertices = _geom.fit_vertices(
            topology, vertices, normals, first, boundary, pull=config.pull, progress=stages.ask
        )
    return _geom.keep_detail(topology, first, vertices) if config.keep_detail else vertices
