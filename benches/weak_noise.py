"""What bringing detail back under weak noise is worth, and what it costs where the noise is uneven.

    python benches/weak_noise.py --preset default --meshes DIR --procedural 6

Every mesh is denoised once; E_a in degrees before, of the cascade alone, and with detail brought back
(`gcnd._geom.keep_detail`). Prints one line for each mesh that comes out worse than it went in, and a table of means by
kind of mesh and noise. DIR holds meshes by kind in subfolders.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from accuracy import NOISE_SEED, Truth, clean_meshes
from levels import parser_of

from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.metrics import normal_error
from gcnd.nn.cascade import Cascade
from gcnd.weights import load_cascade

GAUSSIAN = (0.0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.3)

NOISES: dict[str, dict[str, Any]] = {
    **{f"gaussian {level}": {"level": level} for level in GAUSSIAN},
    "varying 0.02": {"level": 0.02, "kind": "varying"},
    "varying 0.05": {"level": 0.05, "kind": "varying"},
    "impulsive 0.1 of 10 %": {"level": 0.1, "kind": "impulsive", "fraction": 0.1},
    "correlated 0.05": {"level": 0.05, "kind": "correlated"},
}


def three_errors(truth: Truth, noise: dict[str, Any], cascade: Cascade) -> list[float]:
    """E_a in degrees of the input, of the cascade's result and of that with detail brought back."""
    noisy = truth.vertices
    if noise["level"] > 0:
        noisy = add_noise(truth.vertices, truth.faces, seed=NOISE_SEED, **noise)
    plain = denoise_arrays(noisy, truth.faces, cascade)
    kept = _geom.keep_detail(_geom.Topology(truth.faces, len(noisy)), noisy, plain)
    return [normal_error(v, truth.vertices, truth.faces) for v in (noisy, plain, kept)]


def main() -> None:
    """Measures and prints."""
    options = parser_of(__doc__).parse_args()
    cascade = load_cascade(options.preset)
    cascade.config = replace(cascade.config, keep_detail=False)
    errors: dict[str, dict[str, list[list[float]]]] = {name: {} for name in NOISES}
    for truth in clean_meshes(options.procedural, options.shapes, options.meshes):
        for name, noise in NOISES.items():
            found = three_errors(truth, noise, cascade)
            errors[name].setdefault(truth.kind, []).append(found)
            if found[2] > found[0] > 0:
                print(f"{truth.name}, {name}: {found[0]:.2f} -> {found[1]:.2f} -> {found[2]:.2f}", flush=True)
    kinds = sorted({kind for row in errors.values() for kind in row})
    print("| noise |" + "".join(f" {kind}, before | cascade | detail back |" for kind in kinds))
    print("|---|" + "---|---|---|" * len(kinds))
    for name, row in errors.items():
        means = [np.mean(row[kind], axis=0) for kind in kinds]
        print(f"| {name} |" + "".join(f" {value:.2f} |" for mean in means for value in mean))


if __name__ == "__main__":
    main()
