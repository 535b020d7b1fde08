"""One network for both passes against one network each, after as many steps in all.

    python benches/ablations.py networks --steps 500
    python benches/one_network.py --steps 500

Starts from the first network of the ablation's second line and takes its second half: as many steps again, but every
other mesh fresh and noisy, the rest denoised by the first, so that one network learns both. "told" has four channels
more, one number, that say which of the two a mesh is; those channels are the package's for the roughness, which is not
told here. Then the network runs twice over the validation shapes of benches/ablations.py, at its levels. The other
lines are the ablation's two networks, and the first of them run twice.

Nothing of this is in the package.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from ablations import (
    COVERAGE,
    LEVELS,
    NOISE_SEED,
    POOL_SIZE,
    Variant,
    finished,
    kept,
    options_of,
    print_header,
    print_row,
    test_shapes,
    training_shapes,
)
from numpy.typing import NDArray
from torch import nn

from gcnd.data.noise import add_noise
from gcnd.metrics import normal_error
from gcnd.nn.cascade import StageConfig
from gcnd.predict import fast_precision
from gcnd.train import samples
from gcnd.train.grow import grown
from gcnd.train.loop import Trainer
from gcnd.train.pool import DenoisedPool, run_stages
from gcnd.train.samples import FreshNoise, NoisyMesh, VertexSource
from gcnd.weights.registry import load_trainable

TOLD = (np.zeros(4), np.full(4, 1e9))
"""In the place of the roughness, of noisy meshes and of denoised ones: the ends of what it can say."""


class Both:
    """Draws from either source as often, and tells in the place of the roughness which one it was."""

    def __init__(self, *sources: VertexSource):
        self.sources = sources

    def draw(self, rng: np.random.Generator) -> NoisyMesh:
        """Returns a clean shape with positions to learn from."""
        which = int(rng.integers(len(self.sources)))
        return self.sources[which].draw(rng)._replace(roughness=TOLD[which])


def tested(stages: list[tuple[StageConfig, nn.Module]], folder: Path) -> dict[str, float]:
    """Mean E_a in degrees after a pass of each, as ``ablations.tested`` has it, but told the pass."""
    errors: dict[str, list[float]] = {}
    for shape in test_shapes(folder):
        for level in LEVELS:
            noisy: NDArray[np.float64] = add_noise(shape.vertices, shape.faces, level=level, seed=NOISE_SEED)
            mesh = NoisyMesh(shape, noisy, TOLD[0], noisy)
            for number, stage in enumerate(stages):
                mesh = mesh._replace(roughness=TOLD[number])
                mesh = run_stages(mesh, [stage], number, precision=fast_precision("cpu"))
            error = normal_error(mesh.vertices, shape.vertices, shape.faces)
            for key in (shape.kind, f"noise {level}", "all"):
                errors.setdefault(key, []).append(error)
    return {key: round(float(np.mean(values)), 3) for key, values in errors.items()}


def measured(
    told: bool, first: tuple[StageConfig, nn.Module], steps: int, options: object
) -> dict[str, float]:
    """Trains one network for both passes and tests it."""
    samples.blurred = lambda roughness, rng: roughness
    config = replace(Variant(patch={"roughness": told}).config(steps), seed=1)
    shapes = training_shapes(options.shapes)
    noise = FreshNoise(shapes)
    pool = DenoisedPool(options.out / f"pool-1-{steps}", noise, shapes, [first], POOL_SIZE, 0)
    initial = grown(first[1].state_dict(), first[0], config.stage)
    network, speed = finished(Trainer(config, Both(noise, pool), initial))
    weights = sum(p.numel() for p in network.parameters())
    about = {"weights": weights, "patches_per_second": speed}
    return about | tested([(config.stage, network)] * 2, options.shapes)


def main() -> None:
    """Trains what is not there yet and prints a table."""
    options = options_of(__doc__)
    steps, results = options.steps, options.out / "results.json"
    two = load_trainable(str(options.out / f"networks-2-{steps}-steps.safetensors")).eval()
    stages = list(zip(two.config.stages, two.stages, strict=True))
    assert all(config.coverage == COVERAGE for config, _ in stages)
    n = sum(p.numel() for p in two.stages[0].parameters())
    untrained = {"patches_per_second": 0}

    def run_only(stages: list[tuple[StageConfig, nn.Module]], n_weights: int) -> dict[str, float]:
        return untrained | {"weights": n_weights} | tested(stages, options.shapes)

    print_header("two passes")
    for name, measure in {
        "two networks": partial(run_only, stages, 2 * n),
        "the first network twice": partial(run_only, stages[:1] * 2, n),
        "one network": partial(measured, False, stages[0], steps, options),
        "one network, told": partial(measured, True, stages[0], steps, options),
    }.items():
        print_row(name, kept(results, f"one network {name}, {steps} steps", measure))


if __name__ == "__main__":
    main()
