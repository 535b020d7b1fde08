"""E_a of what may follow the last pass: normals refined or not, vertices moved by Eq. 6 alone or fitted besides.

    python benches/vertex_fit.py --preset default --meshes DIR --procedural 6

The shapes are those that training is validated on, and what follows the last pass was chosen on this table;
benches/accuracy.py says how accurate the weights are, on others. DIR holds meshes by kind in subfolders.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from accuracy import Truth, clean_meshes
from last_pass import last_prediction
from levels import parser_of

from gcnd import _geom
from gcnd.data.noise import NoiseKind, add_noise
from gcnd.metrics import normal_error
from gcnd.nn.cascade import Cascade
from gcnd.predict import refined
from gcnd.train.corpus import VALIDATION_SEED, generated_shapes
from gcnd.train.recipes import PULL
from gcnd.weights import load_cascade

NOISE_SEED = 11
NOISES: tuple[tuple[NoiseKind, float], ...] = (
    ("gaussian", 0.02),
    ("gaussian", 0.1),
    ("gaussian", 0.3),
    ("gaussian", 0.7),
    ("impulsive", 0.3),
    ("isotropic", 0.2),
    ("correlated", 0.1),
)


def variants(truth: Truth, noisy: np.ndarray, cascade: Cascade) -> Iterator[tuple[str, float]]:
    """Yields E_a in degrees of every variant, with its name."""
    topology, config = _geom.Topology(truth.faces, len(noisy)), cascade.config
    vertices, prediction = last_prediction(topology, noisy, cascade)
    for where, refinement in zip(
        ("never", "flat meshes", "always"),
        (
            replace(config.refinement, iterations=0),
            replace(config.refinement, flat_only=True),
            replace(config.refinement, flat_only=False),
        ),
        strict=True,
    ):
        normals = refined(topology, vertices, prediction, refinement)
        moved = _geom.update_vertices(topology, vertices, normals, config.vertex_iterations, "along")
        fitted = _geom.fit_vertices(
            topology, moved, normals, noisy, "along", pull=PULL if config.pull is None else config.pull
        )
        for name, result in (("Eq. 6", moved), ("Eq. 6, fit", fitted)):
            yield f"{name}, refined: {where}", normal_error(result, truth.vertices, truth.faces)


def main() -> None:
    """Measures and prints a table of means by kind of mesh and noise."""
    options = parser_of(__doc__).parse_args()
    cascade = load_cascade(options.preset)
    held_out = generated_shapes(options.procedural, VALIDATION_SEED, options.shapes)
    truths = [Truth(shape.name, shape.kind, shape.vertices, shape.faces) for shape in held_out]
    truths += clean_meshes(0, options.shapes, options.meshes)
    errors: dict[str, dict[str, list[float]]] = {}
    for truth in truths:
        for kind, level in NOISES:
            noisy = add_noise(truth.vertices, truth.faces, kind=kind, level=level, seed=NOISE_SEED)
            for name, error in variants(truth, noisy, cascade):
                errors.setdefault(f"{kind} {level}, {truth.kind}", {}).setdefault(name, []).append(error)
        print(truth.name, flush=True)
    names = list(next(iter(errors.values())))
    print("| noise, meshes | " + " | ".join(names) + " |")
    print("|---|" + "---|" * len(names))
    for row, by_name in sorted(errors.items()):
        print(f"| {row} | " + " | ".join(f"{np.mean(by_name[name]):.2f}" for name in names) + " |")


if __name__ == "__main__":
    main()
