"""What each part of the method is worth: variants of the first stage, trained at a small budget, side by side.

    python benches/ablations.py alignment
    python benches/ablations.py knn_k --steps 4000

Every variant of a group is trained from nothing on the same generated shapes and as many patch nodes, with everything
but the one thing that the group is about as in the recipe ``default``; then it denoises validation shapes that nothing
is trained on. A line is kept in DIR/results.json once it is measured, and weights as
DIR/GROUP-VARIANT-STEPS-steps.safetensors, for ``gcnd denoise --preset`` and ``gcnd compare``.

Paper: Sec. 7.5.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.metrics import normal_error
from gcnd.nn.cascade import Cascade, PatchConfig, RefinementConfig, StageConfig
from gcnd.train.corpus import VALIDATION_SEED, generated_shapes
from gcnd.train.loop import TrainConfig, Trainer
from gcnd.train.pool import DenoisedPool
from gcnd.train.recipes import DEFAULT_NETWORK, get_recipe
from gcnd.train.run import adapted
from gcnd.train.samples import ChunkConfig, CleanShape, FreshNoise, NoiseDraw, draw_noise
from gcnd.weights import load_cascade, save_cascade

LEVELS, NOISE_SEED, N_TESTED = (0.1, 0.2, 0.3), 5, 6
N_SHAPES, POOL_SIZE = 240, 30
SHAPE_SEED = 10
COVERAGE = 0.7
NODES_A_STEP = 256 * 64


def normal_noise(rng: np.random.Generator) -> NoiseDraw:
    """Gaussian noise along the normals alone, at the levels of ``draw_noise``."""
    return replace(draw_noise(rng), kind="gaussian")


@dataclass(frozen=True)
class Variant:
    """What differs from the recipe: fields of the network, the patches and the training, the noise, the networks."""

    network: dict[str, Any] = field(default_factory=dict)
    patch: dict[str, Any] = field(default_factory=dict)
    train: dict[str, Any] = field(default_factory=dict)
    noise: Any = draw_noise
    n_networks: int = 1

    def config(self, steps: int) -> TrainConfig:
        """The stage's configuration, with as many patch nodes a step whatever the size of a patch."""
        patch = replace(PatchConfig(scale_space=True), **self.patch)
        network = replace(DEFAULT_NETWORK, in_channels=patch.n_channels, **self.network)
        stage = StageConfig(network, patch, coverage=COVERAGE if network.predicts_nodes else None)
        base = adapted(get_recipe("default")).stages[0]
        batch = NODES_A_STEP // patch.n_nodes
        balance = self.train.get("balance_ratio", base.chunk.balance_ratio)
        chunk = ChunkConfig(n_patches=16 * batch, balance_ratio=balance)
        loss = self.train.get("loss", base.loss)
        return replace(base, stage=stage, steps=steps, batch=batch, chunk=chunk, loss=loss)


def layers(n: int) -> Variant:
    """n static and n dynamic layers of 64 channels, the last of 128."""
    return Variant(network={"static_channels": (64,) * n, "dynamic_channels": (*(64,) * (n - 1), 128)})


GROUPS: dict[str, dict[str, Variant]] = {
    "patch_scale": {
        f"{k}, {n} nodes": Variant(patch={"patch_scale": k, "n_nodes": n})
        for k, n in ((3.0, 64), (4.0, 64), (5.5, 64), (5.5, 128), (8.0, 256))
    },
    "layers": {f"{2 * n}": layers(n) for n in (2, 3, 4)},
    "networks": {f"{n}": Variant(n_networks=n) for n in (1, 2, 3)},
    "alignment": {
        "none": Variant(patch={"voting_region": "nobody"}),
        "spatial transformer": Variant(
            network={"architecture": "transformed-nodes"}, patch={"voting_region": "nobody"}
        ),
        "tensor voting": Variant(),
        "tensor voting, 2-ring": Variant(patch={"voting_region": "two_ring"}),
    },
    "balance_ratio": {
        str(ratio): Variant(train={"balance_ratio": ratio}) for ratio in (None, 0.5, 1.0, 1.5, 5.0, 10.0)
    },
    "graph": {
        "static only": Variant(network={"static_channels": (64, 64, 64, 64, 128), "dynamic_channels": ()}),
        "dynamic only": Variant(network={"static_channels": (), "dynamic_channels": (64, 64, 64, 64, 128)}),
        "both": Variant(),
    },
    "knn_k": {str(k): Variant(network={"knn_k": k}) for k in (4, 8, 12, 16)},
    "features": {
        "8 channels": Variant(patch={"vertex_offsets": False, "scale_space": False}),
        "vertex offsets": Variant(patch={"scale_space": False}),
        "scale space": Variant(patch={"vertex_offsets": False}),
        "both": Variant(),
    },
    "head": {
        "centre, squared loss": Variant(network={"architecture": "centre"}, train={"loss": "mse"}),
        "centre, chord loss": Variant(network={"architecture": "centre"}),
        "nodes, chord loss": Variant(),
    },
    "norm_order": {order: Variant(network={"norm_order": order}) for order in ("edge", "node")},
    "budget": {name: Variant(patch={"budget": name}) for name in ("random", "nearest")},
    "sigma_vote": {
        name: Variant(patch={"sigma_vote": sigma})
        for name, sigma in (("1/6", 1 / 6), ("1/3", 1 / 3), ("2/3", 2 / 3))
    },
    "noise": {"along the normals": Variant(noise=normal_noise), "mixed": Variant()},
    "width": {
        "half": Variant(
            network={
                "static_channels": (32, 32),
                "dynamic_channels": (32, 32, 64),
                "pool_channels": 96,
                "head_channels": (64, 32),
            }
        ),
        "default": Variant(),
        "double": Variant(
            network={
                "static_channels": (128, 128),
                "dynamic_channels": (128, 128, 256),
                "pool_channels": 384,
                "head_channels": (256, 128),
            }
        ),
    },
}
"""By what is varied. In the paper's Sec. 7.5: patch scale, layers, networks, alignment, balance, graph and K."""


def train(variant: Variant, steps: int, shapes: list[CleanShape], folder: Path) -> tuple[Cascade, float]:
    """Trains a variant's networks one after the other; returns the cascade and patches/s of the first."""
    stages: list[tuple[StageConfig, Any]] = []
    noise = FreshNoise(shapes, variant.noise)
    state, speeds = None, []
    for index in range(variant.n_networks):
        config = variant.config(steps)
        source = (
            DenoisedPool(folder / f"pool-{index}-{steps}", noise, shapes, stages, POOL_SIZE, 0)
            if index
            else noise
        )
        trainer = Trainer(replace(config, seed=index), source, state)
        trainer.run(lambda report: speeds.append(report.patches_per_second))
        state = trainer.average.state
        trainer.network.load_state_dict(state)
        stages.append((config.stage, trainer.network.eval()))
    return Cascade.assembled(stages, RefinementConfig(iterations=0)), speeds[steps - 1]


def tested(cascade: Cascade, shapes: list[CleanShape]) -> dict[str, float]:
    """Mean E_a in degrees of the denoised shapes by kind and level."""
    errors: dict[str, list[float]] = {}
    for shape in shapes:
        for level in LEVELS:
            noisy = add_noise(shape.vertices, shape.faces, level=level, seed=NOISE_SEED)
            denoised = denoise_arrays(noisy, shape.faces, cascade)
            error = normal_error(denoised, shape.vertices, shape.faces)
            for key in (shape.kind, f"noise {level}", "all"):
                errors.setdefault(key, []).append(error)
    return {key: round(float(np.mean(values)), 3) for key, values in errors.items()}


def main() -> None:
    """Fills a group's lines in and prints them as a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("group", choices=list(GROUPS))
    parser.add_argument("--steps", type=int, default=1000, help="of 16,384 patch nodes, for each network")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    parser.add_argument("--out", type=Path, default=Path("runs/ablations"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out / "results.json"
    shapes: list[CleanShape] = []
    test_shapes = generated_shapes(N_TESTED, VALIDATION_SEED, options.shapes)
    columns = ["cad", "smooth", "feature", *(f"noise {level}" for level in LEVELS), "all"]
    print(f"| {options.group} | weights | patches/s | " + " | ".join(columns) + " |")
    print("|---" * (3 + len(columns)) + "|")
    for name, variant in GROUPS[options.group].items():
        rows = json.loads(results.read_text()) if results.exists() else {}
        # A variant that is the recipe itself is trained once for all groups.
        key = f"{'recipe' if variant == Variant() else f'{options.group} {name}'}, {options.steps} steps"
        if key not in rows:
            shapes = shapes or generated_shapes(N_SHAPES, SHAPE_SEED, options.shapes)
            cascade, speed = train(variant, options.steps, shapes, options.out)
            # Commas part the methods of gcnd compare.
            name_of_file = key.replace(", ", "-").replace(" ", "-").replace("/", "_")
            path = options.out / f"{name_of_file}.safetensors"
            save_cascade(path, cascade, {"recipe": key})
            weights = sum(p.numel() for p in cascade.parameters())
            about = {"weights": weights, "patches_per_second": round(speed)}
            rows[key] = about | tested(load_cascade(str(path)), test_shapes)
            results.write_text(json.dumps(rows, indent=1))
        row = rows[key]
        figures = " | ".join(f"{row[column]:.2f}" for column in columns)
        print(f"| {name} | {row['weights']:,} | {row['patches_per_second']:,} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
