"""The passes of a cascade over a mesh (paper Fig. 2): patches → network → face normals → vertex update, and again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

from gcnd import _geom
from gcnd.flat import is_flat
from gcnd.predict import Prediction, fast_precision, predict_normals
from gcnd.stages import Stages

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    import torch
    from numpy.typing import NDArray

    from gcnd.nn.cascade import Cascade, StageConfig
    from gcnd.nn.fold import Precision

__all__ = ["Pass", "run_passes"]


class Pass(NamedTuple):
    """One pass over a mesh, before its vertices are updated.

    Attributes:
        stage: What ran, with the coverage of this pass.
        vertices: Positions (V, 3) that it saw, mesh units.
        prediction: What it found.
    """

    stage: StageConfig
    vertices: NDArray[np.float64]
    prediction: Prediction


def run_passes(
    topology: _geom.Topology,
    first: NDArray[np.float64],
    cascade: Cascade,
    *,
    roughness: NDArray[np.float64] | None = None,
    device: torch.device | str = "cpu",
    seed: int = 0,
    precision: Precision | None = None,
    vertex_iterations: int | None = None,
    boundary: Literal["free", "along", "fixed"] = "along",
    stages: Stages | None = None,
) -> Iterator[Pass]:
    """Yields every pass of a cascade; between two of them the vertices are updated, after the last they are not.

    A mesh that turns out flat before the last pass gets those passes more that the cascade has for it.

    Args:
        topology: Adjacency of the mesh.
        first: Positions (V, 3) to start from, mesh units, each once.
        cascade: Networks with what they expect of patches.
        roughness: Of ``first`` (4,), as ``_geom.mesh_roughness`` gives it, where it is known.
        device: Where the cascade's weights are; the others as of ``denoise``.
        stages: Told how far the passes have come, 0 to 1.

    Paper: Sec. 5.1, "cascaded GCNs". Choice: docs/choices.md#flat-meshes.
    """
    stages = stages or Stages(None)
    iterations = cascade.config.vertex_iterations if vertex_iterations is None else vertex_iterations
    if cascade.sees_roughness and roughness is None:
        roughness = _geom.mesh_roughness(topology, first)
    vertices, passes, done = first, cascade.passes(), 0.0
    last_but_one = len(passes) - 2
    for index, (stage, network) in enumerate(passes):
        number = f"pass {index + 1} of {len(passes)}"
        share = (1.0 - done) / (len(passes) - index)
        prediction = predict_normals(
            topology,
            vertices,
            stage,
            network,
            seed=(seed + index) % 2**64,
            roughness=roughness,
            first=first,
            device=device,
            precision=precision or fast_precision(device),
            progress=_part(stages, done, share, f"normals, {number}"),
        )
        done += share
        stages(done, f"vertices, {number}")
        yield Pass(stage, vertices, prediction)
        if index == len(passes) - 1:
            return
        vertices = _geom.update_vertices(
            topology, vertices, prediction.normals, iterations, boundary, progress=stages.ask
        )
        if index == last_but_one and cascade.config.flat_passes and is_flat(topology, vertices):
            passes[-1:-1] = cascade.flat_passes()


def _part(stages: Stages, done: float, share: float, label: str) -> Callable[[float], None]:
    """Turns the fraction done of one part of a run, which begins at ``done``, into that of the whole."""

    def report(fraction: float) -> None:
        stages(done + share * fraction, label)

    report(0.0)
    return report
