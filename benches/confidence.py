"""Does the confidence rank the true errors? Spearman's rank correlation by kind of shape and level of noise.

    python benches/confidence.py [--preset default] [--shapes 9] [--levels 0.1 0.2 0.3]

Correlates 1 − confidence of each face with the angle between its normal in the result and in the truth, mesh by mesh,
and prints means by kind; also E_a, and E_a of the tenth of the faces with the least confidence.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from gcnd import Denoiser
from gcnd.data.generated import load_generated
from gcnd.data.noise import add_noise
from gcnd.data.shapes import SHAPE_KINDS, Shape
from gcnd.metrics import normal_angles

FIRST_SEED = 70_000
"""Of shapes that no training run has drawn."""


def measure(shape: Shape, level: float, denoiser: Denoiser) -> tuple[float, float, float]:
    """Rank correlation, E_a in degrees, and E_a of the tenth with the least confidence."""
    noisy = add_noise(shape.vertices, shape.faces, level=level, seed=1)
    done = denoiser.run((noisy, shape.faces))
    assert done.confidence is not None
    errors = normal_angles(done.after, shape.vertices, shape.faces)
    is_known = np.isfinite(errors)
    errors, doubt = errors[is_known], 1.0 - done.confidence[is_known]
    worst = errors[doubt >= np.quantile(doubt, 0.9)]
    return float(spearmanr(doubt, errors).statistic), float(errors.mean()), float(worst.mean())


def main() -> None:
    """Measures and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--shapes", type=int, default=9)
    parser.add_argument("--levels", type=float, nargs="+", default=[0.1, 0.2, 0.3])
    parser.add_argument("--folder", type=Path, default=Path("runs/shapes"))
    options = parser.parse_args()
    denoiser = Denoiser(options.preset)
    shapes = load_generated(options.shapes, FIRST_SEED, options.folder, hint="pip install 'gcnd[train]'")
    found: dict[tuple[str, float], list[tuple[float, float, float]]] = {}
    for shape in shapes:
        for level in options.levels:
            row = measure(shape, level, denoiser)
            found.setdefault((shape.kind, level), []).append(row)
            print(
                f"{shape.name} {level}: {row[0]:.2f}, E_a {row[1]:.2f}, of the doubtful tenth {row[2]:.2f}",
                flush=True,
            )
    print("| kind | shapes | level | rank correlation | least, most | E_a | E_a of the doubtful tenth |")
    print("|---|---|---|---|---|---|---|")
    for kind in SHAPE_KINDS:
        for level in options.levels:
            rows = np.array(found.get((kind, level), []))
            if len(rows):
                rank, e_a, worst = rows.mean(axis=0)
                low, high = rows[:, 0].min(), rows[:, 0].max()
                cells = (f"{rank:.2f}", f"{low:.2f}, {high:.2f}", f"{e_a:.2f}", f"{worst:.2f}")
                print(f"| {kind} | {len(rows)} | {level} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
