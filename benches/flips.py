"""E_a when every patch is seen in several frames and the answers are averaged, against more patches for the same work.

    python benches/flips.py --preset default

Axes by tensor voting have no sign; patches take the one of docs/choices.md#frame-signs. Half turns about the three axes
are the other frames that it could have been. "2 frames" adds the turn about e_3, "4 frames" those about e_1 and e_2.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gcnd import predict
from gcnd.denoise import denoise_arrays
from gcnd.metrics import normal_error
from gcnd.nn.cascade import Cascade, PatchConfig
from gcnd.train.corpus import VALIDATION_SEED, generated_shapes
from gcnd.weights import load_cascade

N_SHAPES = 6
LEVELS, NOISE_SEED = (0.1, 0.3), 3
TURNS = ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1))
"""Diagonals of the turns."""

N_SCALARS = 4
"""Of the roughness, at the end of the channels."""


def channel_signs(turn: tuple[int, ...], patch: PatchConfig) -> Tensor:
    """(C,) what a turn multiplies every channel of the features with."""
    n_vectors = (patch.n_channels - 8 - N_SCALARS * patch.roughness) // 3
    scalars = (1,) * (N_SCALARS * patch.roughness)
    return torch.tensor((*turn * 2, 1, 1, *turn * n_vectors, *scalars), dtype=torch.float32)


class TurnedMean(nn.Module):
    """The mean of a network's normals over the first frames of `TURNS`."""

    def __init__(self, network: nn.Module, patch: PatchConfig, n_frames: int):
        super().__init__()
        self.network = network
        self.turns = [(channel_signs(turn, patch), torch.tensor(turn)) for turn in TURNS[:n_frames]]

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C) features and (P, N, 3) neighbours to (P, N, 3) normals, as the network does."""
        normals = [signs * self.network(features * of, neighbors) for of, signs in self.turns]
        return nn.functional.normalize(torch.stack(normals).sum(dim=0), dim=-1)


def turned(
    for_inference: Callable[..., nn.Module], patch: PatchConfig, n_frames: int
) -> Callable[..., nn.Module]:
    """Stands in for ``gcnd.predict.for_inference``."""
    return lambda *arguments: TurnedMean(for_inference(*arguments), patch, n_frames)


def with_coverage(cascade: Cascade, factor: float) -> Cascade:
    """Multiplies every pass's coverage."""
    stages = tuple(
        replace(
            stage,
            coverage=factor * (stage.coverage or 1),
            early_coverage=None if stage.early_coverage is None else factor * stage.early_coverage,
        )
        for stage in cascade.config.stages
    )
    cascade.config = replace(cascade.config, stages=stages)
    return cascade


def main() -> None:
    """Prints E_a by kind and level for frames and coverages."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    options = parser.parse_args()
    shapes = generated_shapes(N_SHAPES, VALIDATION_SEED, options.shapes)
    ours = predict.for_inference
    columns = [f"{kind} {level}" for kind in ("cad", "feature", "smooth") for level in LEVELS]
    print("| frames | coverage | " + " | ".join(columns) + " | all |")
    print("|---|---|" + "---|" * (len(columns) + 1))
    for n_frames, factor in ((1, 1.0), (2, 1.0), (4, 1.0), (1, 2.0), (1, 4.0)):
        cascade = with_coverage(load_cascade(options.preset), factor)
        predict.for_inference = turned(ours, cascade.config.stages[0].patch, n_frames)
        errors: dict[str, list[float]] = {}
        for shape in shapes:
            for level in LEVELS:
                noisy = shape.noise.sample(level=level, seed=NOISE_SEED)
                clean = denoise_arrays(noisy, shape.faces, cascade)
                error = normal_error(clean, shape.vertices, shape.faces)
                errors.setdefault(f"{shape.kind} {level}", []).append(error)
        means = [float(np.mean(errors[column])) for column in columns]
        figures = " | ".join(f"{mean:.3f}" for mean in (*means, float(np.mean(means))))
        print(f"| {n_frames} | {factor:.0f} × | {figures} |", flush=True)


if __name__ == "__main__":
    main()
