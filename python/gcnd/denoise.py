"""The straight line: a noisy mesh in, a clean mesh out (paper Fig. 2).

load → topology (once) → [patches → network → face normals → vertex update] per stage → refined normals at the
last → save.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd import _geom
from gcnd.errors import check_count
from gcnd.mesh_io import to_arrays
from gcnd.predict import fast_precision, predict_normals, refined
from gcnd.weights import load_cascade

if TYPE_CHECKING:
    from collections.abc import Callable

    import torch
    from numpy.typing import NDArray

    from gcnd.nn.cascade import Cascade
    from gcnd.nn.fold import Precision


def denoise(
    mesh: Any,
    *,
    preset: str = "default",
    device: torch.device | str = "cpu",
    seed: int = 0,
    normal_iterations: int | None = None,
    vertex_iterations: int | None = None,
    precision: Precision | None = None,
    progress: Callable[[float, str], object] | None = None,
) -> Any:
    """Removes noise from a triangle mesh and keeps its features.

    Faces and the order of vertices stay; only positions change. Vertices at exactly the same position, as STL
    files and texture seams repeat them, move together. The input is left as it is.

    Args:
        mesh: A ``trimesh.Trimesh``, a pair (vertices (V, 3), faces (F, 3)) of numpy or torch arrays, or a path.
        preset: Name of shipped weights (``gcnd models`` lists them), or the path of a weights file.
        device: "cpu", or "cuda" where torch has it.
        seed: Chooses the patches that cover the mesh; the same seed gives the same result on the CPU.
        normal_iterations: m, iterations of normal refinement (Eq. 5) on every face after the last stage; 0 is none.
            The paper takes 12 for CAD models and depth-camera scans, 1 otherwise. ``None`` does what the preset
            says: ours refines where overlapping predictions allow it.
        vertex_iterations: Iterations of vertex updating (Eq. 6) after each stage; ``None`` takes the preset's, 15.
        precision: "float32" or "bfloat16" for the network's products; ``None`` takes the fastest that is measured safe
            on the device, see ``gcnd.predict.fast_precision``.
        progress: Called now and then with (fraction done, what is being done).

    Returns:
        The same kind as ``mesh`` (a ``trimesh.Trimesh`` for a path), with float64 positions or the input's dtype.

    Raises:
        MeshError: The mesh cannot be worked on: no faces, NaN, an index out of range, a file that is not a mesh.
        ConfigError: A parameter is out of range or the preset is unknown.
        WeightsError: The weights cannot be read or do not fit.

    Paper: Secs. 3–6.

    Example:
        >>> import gcnd, trimesh
        >>> noisy = trimesh.creation.icosphere(subdivisions=3)
        >>> clean = gcnd.denoise(noisy)
        >>> bool((clean.faces == noisy.faces).all())
        True
    """
    check_count("seed", seed)
    check_count("normal_iterations", normal_iterations)
    check_count("vertex_iterations", vertex_iterations)
    arrays, rebuild = to_arrays(mesh)
    _geom.validate(arrays.vertices, arrays.faces)
    cascade = load_cascade(preset, device)
    mesh_once, ids = arrays.welded()
    vertices = denoise_arrays(
        mesh_once.vertices,
        mesh_once.faces,
        cascade,
        device=device,
        seed=seed,
        normal_iterations=normal_iterations,
        vertex_iterations=vertex_iterations,
        precision=precision,
        progress=progress,
    )
    return rebuild(vertices[ids])


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
    progress: Callable[[float, str], object] | None = None,
) -> NDArray[np.float64]:
    """Runs a cascade over arrays; the line of ``denoise`` between reading and writing.

    Args:
        vertices: Positions (V, 3), mesh units, finite, each position once.
        faces: Vertex ids (F, 3).
        cascade: Networks with what they expect of patches.
        device: Where the cascade's weights are.
        seed: See ``denoise``.
        normal_iterations: See ``denoise``.
        vertex_iterations: See ``denoise``.
        precision: See ``denoise``.
        progress: See ``denoise``.

    Returns:
        Denoised positions (V, 3), mesh units.

    Paper: Fig. 2; Sec. 6 for what follows the last network.
    """
    if vertex_iterations is None:
        vertex_iterations = cascade.config.vertex_iterations
    precision = precision or fast_precision(device)
    refinement = cascade.config.refinement
    if normal_iterations is not None:
        refinement = replace(refinement, iterations=normal_iterations, tolerance=None)
    # Work around the origin: far away from it, single positions keep fewer digits than noise has.
    origin = vertices.mean(axis=0)
    vertices = vertices - origin
    topology = _geom.Topology(faces, len(vertices))
    roughness = _geom.mesh_roughness(topology, vertices) if cascade.sees_roughness else None
    passes = cascade.passes()
    for index, (stage, network) in enumerate(passes):
        label = f"normals, pass {index + 1} of {len(passes)}"

        def report(fraction: float, index: int = index, label: str = label) -> None:
            if progress is not None:
                progress((index + fraction) / len(passes), label)

        report(0.0)
        prediction = predict_normals(
            topology,
            vertices,
            stage,
            network,
            seed=(seed + index) % 2**64,
            roughness=roughness,
            device=device,
            precision=precision,
            progress=report,
        )
        is_last = index == len(passes) - 1
        normals = refined(topology, vertices, prediction, refinement) if is_last else prediction.normals
        vertices = _geom.update_vertices(topology, vertices, normals, vertex_iterations)
    if progress is not None:
        progress(1.0, "done")
    moved: NDArray[np.float64] = vertices + origin
    return moved
