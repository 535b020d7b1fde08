"""What benches look at inside a denoise: the last stage's prediction, before refinement and vertex updating."""

from __future__ import annotations

import numpy as np

from gcnd import _geom
from gcnd.nn.cascade import Cascade
from gcnd.predict import Prediction, fast_precision, predict_normals


def last_prediction(
    topology: _geom.Topology, vertices: np.ndarray, cascade: Cascade
) -> tuple[np.ndarray, Prediction]:
    """Runs a cascade up to its last stage, as ``gcnd.denoise`` does with seed 0.

    Returns:
        Positions (V, 3) before the last vertex update, and the last stage's prediction.
    """
    passes, first = cascade.passes(), vertices
    roughness = _geom.mesh_roughness(topology, vertices) if cascade.sees_roughness else None
    for index, (stage, network) in enumerate(passes):
        precision = fast_precision("cpu")
        prediction = predict_normals(
            topology,
            vertices,
            stage,
            network,
            seed=index,
            roughness=roughness,
            first=first,
            precision=precision,
        )
        if index < len(passes) - 1:
            iterations = cascade.config.vertex_iterations
            vertices = _geom.update_vertices(topology, vertices, prediction.normals, iterations)
    return vertices, prediction
