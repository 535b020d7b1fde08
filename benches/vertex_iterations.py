"""E_a of simulated scans by iterations of vertex updating, after the first pass of a preset.

    python benches/vertex_iterations.py --preset scan

Scans of the six shapes that training is validated on, every kind in turn, as `gcnd.scans.training` draws them.
"Normals" are those predicted, which vertex updating (Eq. 6) is to reach.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gcnd import _geom
from gcnd.predict import predict_normals
from gcnd.scans import SCAN_KINDS
from gcnd.scans.training import TrainingPair, load_training_pairs
from gcnd.train.corpus import N_VALIDATION, VALIDATION_SEED, generated_shapes
from gcnd.weights import load_cascade

ITERATIONS = (15, 40, 60, 100, 300)
SEED = VALIDATION_SEED + 1


def errors(pair: TrainingPair, preset: str) -> list[float]:
    """Mean angle to the true normals of the predicted ones, and of the faces after each number of iterations."""
    stage, network = load_cascade(preset).passes()[0]
    topology = _geom.Topology(pair.faces, len(pair.noisy_vertices))
    vertices = pair.noisy_vertices - pair.noisy_vertices.mean(axis=0)
    roughness = _geom.mesh_roughness(topology, vertices)
    predicted = predict_normals(topology, vertices, stage, network, roughness=roughness).normals
    truth = _geom.face_geometry(pair.clean_vertices, pair.faces)[0]
    found = [predicted]
    for iterations in ITERATIONS:
        moved = _geom.update_vertices(topology, vertices, predicted, iterations)
        found.append(_geom.face_geometry(moved, pair.faces)[0])
    return [float(np.nanmean(_geom.normal_angles(normals, truth))) for normals in found]


def main() -> None:
    """Prints a line for each kind of scan."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="scan")
    parser.add_argument("--scans", type=int, default=12)
    parser.add_argument("--folder", type=Path, default=Path("runs"), help="keeps shapes and scans")
    options = parser.parse_args()
    shapes = generated_shapes(N_VALIDATION, VALIDATION_SEED, options.folder / "shapes")
    pairs = load_training_pairs(
        shapes, options.scans, SEED, options.folder / "scans-validation", kinds=SCAN_KINDS
    )
    head = " | ".join(str(n) for n in ITERATIONS)
    print(f"| kind | normals | {head} |\n|---|---|{'---|' * len(ITERATIONS)}")
    for kind in SCAN_KINDS:
        own = np.mean([errors(pair, options.preset) for pair in pairs if pair.kind == kind], axis=0)
        print(f"| {kind} | {' | '.join(f'{value:.2f}' for value in own)} |", flush=True)


if __name__ == "__main__":
    main()
