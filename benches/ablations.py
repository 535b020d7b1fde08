"""What each part of the method is worth: variants of the first stage, trained at a small budget, side by side.

    python benches/ablations.py alignment
    python benches/ablations.py knn_k --steps 4000
    python benches/ablations.py layers --steps 500 --report runs/layers

Every variant of a group is trained from nothing on the same generated shapes and as many patch nodes, with everything
but the one thing that the group is about as in the recipe ``default``; then it denoises validation shapes that nothing
is trained on. A line is kept in DIR/results.json once it is measured, and weights as
DIR/GROUP-VARIANT-STEPS-steps.safetensors, for ``gcnd denoise --preset`` and ``gcnd compare``; with ``--report`` that
comparison is made as well, of all variants on the same noisy meshes, with its tables and its page.

Paper: Sec. 7.5.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

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
COLUMNS = ("cad", "smooth", "feature", *(f"noise {level}" for level in LEVELS), "all")


def normal_noise(rng: np.random.Generator) -> tuple[NoiseDraw, ...]:
    """Gaussian noise along the normals alone, at the levels of ``draw_noise``."""
    return tuple(replace(noise, kind="gaussian") for noise in draw_noise(rng))


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


@cache
def training_shapes(folder: Path) -> list[CleanShape]:
    """The shapes that all variants are trained on, read once."""
    return generated_shapes(N_SHAPES, SHAPE_SEED, folder)


@cache
def test_shapes(folder: Path) -> list[CleanShape]:
    """The shapes that all variants are tested on."""
    return generated_shapes(N_TESTED, VALIDATION_SEED, folder)


def finished(trainer: Trainer) -> tuple[nn.Module, int]:
    """Trains to the last step; returns the network with its averaged weights, and patches/s."""
    speeds: list[float] = []
    trainer.run(lambda report: speeds.append(report.patches_per_second))
    trainer.network.load_state_dict(trainer.average.state)
    return trainer.network.eval(), round(speeds[-1])


def train(variant: Variant, steps: int, shapes: list[CleanShape], folder: Path) -> tuple[Cascade, int]:
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
        network, speed = finished(Trainer(replace(config, seed=index), source, state))
        state = network.state_dict()
        speeds.append(speed)
        stages.append((config.stage, network))
    return Cascade.assembled(stages, RefinementConfig(iterations=0)), speeds[0]


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


def kept(results: Path, key: str, measure: Callable[[], dict[str, float]]) -> dict[str, float]:
    """Returns a line of a file of results, measured where it is not there yet."""
    rows: dict[str, dict[str, float]] = json.loads(results.read_text()) if results.exists() else {}
    if key not in rows:
        rows[key] = measure()
        results.write_text(json.dumps(rows, indent=1))
    return rows[key]


def print_header(about: str) -> None:
    """Prints the first two lines of a table of ``print_row``."""
    print(f"| {about} | weights | patches/s | " + " | ".join(COLUMNS) + " |")
    print("|---" * (3 + len(COLUMNS)) + "|", flush=True)


def print_row(name: str, row: dict[str, float]) -> None:
    """Prints one line of a table: weights, patches/s and what ``tested`` says."""
    figures = " | ".join(f"{row[column]:.2f}" for column in COLUMNS)
    print(f"| {name} | {row['weights']:,} | {row['patches_per_second']:,} | {figures} |", flush=True)


def options_of(text: str, group: Sequence[str] = ()) -> argparse.Namespace:
    """Reads the command line: steps and folders, and one of a list where there is one."""
    parser = argparse.ArgumentParser(description=text.split("\n")[0])
    if group:
        parser.add_argument("group", choices=group)
        parser.add_argument("--report", type=Path, help="folder for a comparison of the variants on builtin")
    parser.add_argument("--steps", type=int, default=1000, help="of 16,384 patch nodes, for each network")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    parser.add_argument("--out", type=Path, default=Path("runs/ablations"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    return options


def weights_name(key: str) -> str:
    """The file of a variant's weights; without commas, which part the methods of ``gcnd compare``."""
    return key.replace(", ", "-").replace(" ", "-").replace("/", "_") + ".safetensors"


def main() -> None:
    """Fills a group's lines in and prints them as a table."""
    options = options_of(__doc__, list(GROUPS))

    def measured(key: str, path: Path, variant: Variant) -> dict[str, float]:
        cascade, speed = train(variant, options.steps, training_shapes(options.shapes), options.out)
        save_cascade(path, cascade, {"recipe": key})
        weights = sum(p.numel() for p in cascade.parameters())
        about = {"weights": weights, "patches_per_second": speed}
        return about | tested(load_cascade(str(path)), test_shapes(options.shapes))

    print_header(options.group)
    weights_files = []
    for name, variant in GROUPS[options.group].items():
        # A variant that is the recipe itself is trained once for all groups.
        key = f"{'recipe' if variant == Variant() else f'{options.group} {name}'}, {options.steps} steps"
        weights_files.append(options.out / weights_name(key))
        measure = partial(measured, key, weights_files[-1], variant)
        print_row(name, kept(options.out / "results.json", key, measure))
    if options.report is not None:
        methods = ",".join(str(path) for path in weights_files)
        command = ["compare", "builtin", "--methods", methods, "--out", str(options.report)]
        subprocess.run([sys.executable, "-m", "gcnd", *command], check=True)


if __name__ == "__main__":
    main()
