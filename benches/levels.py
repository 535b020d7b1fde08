"""E_a before and after over the whole range of noise, from none on: does any mesh come out worse than it went in?

    python benches/levels.py --preset default --meshes DIR --procedural 6

Prints one line a mesh and level, and a table of means by kind. DIR holds meshes by kind in subfolders.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from accuracy import NOISE_SEED, Truth, clean_meshes

from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.metrics import normal_error
from gcnd.nn.cascade import Cascade
from gcnd.weights import load_cascade

LEVELS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.7)


def before_and_after(truth: Truth, level: float, cascade: Cascade) -> tuple[float, float]:
    """E_a in degrees of the noisy mesh and of the denoised one."""
    noisy = add_noise(truth.vertices, truth.faces, level=level, seed=NOISE_SEED) if level else truth.vertices
    denoised = denoise_arrays(noisy, truth.faces, cascade)
    return tuple(normal_error(v, truth.vertices, truth.faces) for v in (noisy, denoised))  # type: ignore[return-value]


def parser_of(text: str) -> argparse.ArgumentParser:
    """The options of a bench that runs one preset on generated shapes and on a folder of meshes."""
    parser = argparse.ArgumentParser(description=text.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--procedural", type=int, default=6)
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    parser.add_argument("--meshes", type=Path)
    return parser


def main() -> None:
    """Measures and prints."""
    parser = parser_of(__doc__)
    parser.add_argument("--levels", type=float, nargs="+", default=LEVELS)
    options = parser.parse_args()
    cascade = load_cascade(options.preset)
    errors: dict[tuple[str, float], list[tuple[float, float]]] = {}
    for truth in clean_meshes(options.procedural, options.shapes, options.meshes):
        for level in options.levels:
            before, after = before_and_after(truth, level, cascade)
            errors.setdefault((truth.kind, level), []).append((before, after))
            worse = "  WORSE" if after > before and level > 0 else ""
            print(f"{truth.name} {truth.kind} {level}: {before:.2f} -> {after:.2f}{worse}", flush=True)
    kinds = sorted({kind for kind, _ in errors})
    print("| level |" + "".join(f" {kind}, before | after | worst after |" for kind in kinds))
    print("|---|" + "---|---|---|" * len(kinds))
    for level in options.levels:
        line = f"| {level} |"
        for kind in kinds:
            before, after = np.array(errors[kind, level]).T
            line += f" {before.mean():.2f} | {after.mean():.2f} | {after.max():.2f} |"
        print(line)


if __name__ == "__main__":
    main()
