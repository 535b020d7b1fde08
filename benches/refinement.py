"""E_a after different refinements of the last stage's normals, on shapes that no weights were trained on.

    python benches/refinement.py --preset default

The shipped refinement was chosen on this table, so the table says nothing about how accurate the weights are;
benches/accuracy.py does, on other shapes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from last_pass import last_prediction

from gcnd import _geom
from gcnd.nn.cascade import RefinementConfig
from gcnd.predict import refined
from gcnd.train.corpus import VALIDATION_SEED, generated_shapes
from gcnd.weights import load_cascade

N_SHAPES = 12
LEVELS = (0.1, 0.3)
NOISE_SEED = 3

REFINEMENTS = {
    "none": RefinementConfig(0),
    "m 1": RefinementConfig(1, 0.3),
    "m 4": RefinementConfig(4, 0.3),
    "m 12": RefinementConfig(12, 0.3),
    "m 12, σ_r 0.15": RefinementConfig(12, 0.15),
    **{f"m 12, σ_r 0.15, k {k}": RefinementConfig(12, 0.15, k) for k in (1.0, 1.5, 2.0, 3.0)},
    **{
        f"m 12, σ_r 0.15, k {k}, s ≤ {limit}": RefinementConfig(12, 0.15, k, limit)
        for k in (1.0, 1.5, 2.0, 3.0)
        for limit in (0.01, 0.02, 0.03, 0.05)
    },
}


def main() -> None:
    """Prints E_a by kind for every refinement."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    options = parser.parse_args()
    cascade = load_cascade(options.preset)
    errors: dict[str, dict[str, list[float]]] = {name: {} for name in REFINEMENTS}
    for shape in generated_shapes(N_SHAPES, VALIDATION_SEED, options.shapes):
        for level in LEVELS:
            noisy = shape.noise.sample(level=level, seed=NOISE_SEED)
            vertices, prediction = last_prediction(shape.topology, noisy, cascade)
            iterations = cascade.config.vertex_iterations
            kind = f"{shape.kind}, decimated" if "decimated" in shape.name else shape.kind
            for name, refinement in REFINEMENTS.items():
                normals = refined(shape.topology, vertices, prediction, refinement)
                moved = _geom.update_vertices(shape.topology, vertices, normals, iterations)
                angles = _geom.normal_angles(_geom.face_geometry(moved, shape.faces)[0], shape.normals)
                errors[name].setdefault(kind, []).append(float(np.nanmean(angles)))
    kinds = sorted(next(iter(errors.values())))
    print("| refinement | " + " | ".join(kinds) + " |")
    print("|---|" + "---|" * len(kinds))
    for name, by_kind in errors.items():
        print(f"| {name} | " + " | ".join(f"{np.mean(by_kind[kind]):.2f}" for kind in kinds) + " |")


if __name__ == "__main__":
    main()
