"""E_a and patches a face by how patches cover the mesh: blindly, or where predictions are missing.

    python benches/cover.py --preset default

"blind p" centres patches on a fraction p of the faces drawn at random and on every face that these leave out;
"coverage w" is ``StageConfig.coverage``. Every pass of the cascade is covered alike.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcnd import _geom, predict
from gcnd.denoise import denoise_arrays
from gcnd.metrics import normal_error
from gcnd.nn.cascade import Cascade
from gcnd.train.corpus import VALIDATION_SEED, generated_shapes
from gcnd.weights import load_cascade

N_SHAPES = 6
LEVEL, NOISE_SEED = 0.2, 3
BLIND = (0.05, 0.1, 0.2, 0.4)
COVERAGE = (0.5, 0.7, 1.0, 1.5, 2.0, 3.0)

Chunks = Iterator[tuple[float, np.ndarray]]


def blind(accumulator: _geom.NormalAccumulator, n_faces: int, fraction: float, seed: int) -> Chunks:
    """Stands in for ``gcnd.predict._cover``: centres that know nothing of each other."""
    order = np.random.default_rng(seed).permutation(n_faces)[: round(fraction * n_faces)]
    yield 0.5, np.sort(order).astype(np.uint32)
    # Below the weight of anything that a patch may see.
    yield 1.0, _geom.Cover(n_faces, 1e-9, seed).next_centers(accumulator, n_faces)


def counted(cover: Callable[..., Chunks], counts: list[int]) -> Callable[..., Chunks]:
    """The same cover; the number of its patches goes to ``counts``."""

    def chunks(*arguments: object) -> Chunks:
        for done, centers in cover(*arguments):
            counts.append(len(centers))
            yield done, centers

    return chunks


def covered(cascade: Cascade, value: float) -> Cascade:
    """Sets the coverage of every pass, in place, and lets every mesh have as many passes."""
    stages = tuple(replace(stage, coverage=value, early_coverage=None) for stage in cascade.config.stages)
    cascade.config = replace(cascade.config, stages=stages, flat_passes=0)
    return cascade


def main() -> None:
    """Prints E_a by kind for every way to cover."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    options = parser.parse_args()
    cascade = load_cascade(options.preset)
    ours = predict._cover
    ways = {f"blind {p}": (blind, p) for p in BLIND} | {f"coverage {w}": (ours, w) for w in COVERAGE}
    shapes = generated_shapes(N_SHAPES, VALIDATION_SEED, options.shapes)
    kinds = sorted({shape.kind for shape in shapes})
    print("| cover | patches a face | " + " | ".join(kinds) + " |")
    print("|---|---|" + "---|" * len(kinds))
    for name, (way, value) in ways.items():
        counts: list[int] = []
        predict._cover = counted(way, counts)
        errors: dict[str, list[float]] = {kind: [] for kind in kinds}
        for shape in shapes:
            noisy = shape.noise.sample(level=LEVEL, seed=NOISE_SEED)
            clean = denoise_arrays(noisy, shape.faces, covered(cascade, value))
            errors[shape.kind].append(normal_error(clean, shape.vertices, shape.faces))
        n_faces = len(cascade.passes()) * sum(len(shape.faces) for shape in shapes)
        cells = " | ".join(f"{np.mean(errors[kind]):.3f}" for kind in kinds)
        print(f"| {name} | {sum(counts) / n_faces:.3f} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
