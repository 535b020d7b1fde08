"""What benches look at inside a denoise: the last stage's prediction, before refinement and vertex updating."""

from __future__ import annotations

import numpy as np

from gcnd import _geom
from gcnd.nn.cascade import Cascade
from gcnd.passes import run_passes
from gcnd.predict import Prediction


def last_prediction(
    topology: _geom.Topology, vertices: np.ndarray, cascade: Cascade
) -> tuple[np.ndarray, Prediction]:
    """Runs a cascade up to its last stage, as ``gcnd.denoise`` does with seed 0.

    Returns:
        Positions (V, 3) before the last vertex update, and the last stage's prediction.
    """
    *_, last = run_passes(topology, vertices, cascade)
    return last.vertices, last.prediction
