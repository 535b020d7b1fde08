"""Refinement of predicted normals: where the predictions disagree, and how much of that counts."""

from __future__ import annotations

import numpy as np
import trimesh

from gcnd import _geom
from gcnd.nn.cascade import RefinementConfig
from gcnd.predict import Prediction, refined


def test_a_limit_on_the_spread_keeps_normals_that_predictions_disagree_about() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = np.array(ball.vertices), ball.faces.astype(np.uint32)
    topology = _geom.Topology(faces, len(vertices))
    rng = np.random.default_rng(0)
    rough = ball.face_normals + 0.2 * rng.standard_normal(ball.face_normals.shape)
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    prediction = Prediction(rough, np.full(len(faces), 0.3))

    def moved(**options: float) -> float:
        config = RefinementConfig(iterations=4, sigma_r=0.5, **options)  # type: ignore[arg-type]
        return float(np.linalg.norm(refined(topology, vertices, prediction, config) - rough, axis=1).mean())

    everywhere = moved()
    assert everywhere > 0.15
    assert moved(tolerance=3.0) > 0.95 * everywhere
    assert moved(tolerance=3.0, largest_spread=0.5) == moved(tolerance=3.0)
    assert moved(tolerance=3.0, largest_spread=0.03) < 0.05 * everywhere
