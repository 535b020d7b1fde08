"""A teacher for the first stage: targets half the truth and half what the shipped first stage answers.

    python benches/distillation.py --steps 500

Students of the recipe's width and of half of it, trained and tested as the variants of benches/ablations.py, without a
teacher and with one. The same patches in the same order; the teacher is told the roughness of their mesh, exactly, and
its students are not. Results are kept with those of the ablations; nothing of this is in the package.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from ablations import (
    GROUPS,
    Variant,
    finished,
    kept,
    options_of,
    print_header,
    print_row,
    test_shapes,
    tested,
    training_shapes,
)
from torch import Tensor
from torch.nn import functional as F

from gcnd.nn.cascade import Cascade, RefinementConfig, StageConfig
from gcnd.nn.fold import for_inference
from gcnd.train import samples
from gcnd.train.loop import TrainConfig, Trainer
from gcnd.train.samples import Batch, FreshNoise, VertexSource
from gcnd.weights import load_cascade

TEACHER_SHARE = 0.5
"""Of the teacher's answer in the target, the truth's being the rest."""


class Student(Trainer):
    """Learns from a mixture of clean normals and a teacher's."""

    def __init__(
        self, config: TrainConfig, source: VertexSource, teacher: StageConfig, network: torch.nn.Module
    ):
        super().__init__(config, source)
        self.teacher = for_inference(network, config.precision)
        self.n_channels = config.stage.network.in_channels
        # Patches are cut with all channels that the teacher sees; the student takes the first of them.
        self.config = replace(config, stage=replace(teacher, coverage=config.stage.coverage))

    def loss_of(self, batch: Batch) -> Tensor:
        """Runs both on a batch and returns the student's loss."""
        with torch.no_grad():
            answer = F.normalize(self.teacher(batch.features, batch.neighbors), dim=-1)
            mixed = F.normalize(torch.lerp(batch.target, answer, TEACHER_SHARE), dim=-1)
        # Copied, as the kernels take whole rows.
        seen = batch.features[..., : self.n_channels].contiguous()
        return super().loss_of(batch._replace(features=seen, target=mixed))


def measured(variant: Variant, steps: int, folder: Path) -> dict[str, float]:
    """Trains one student under the teacher and tests it."""
    # Drawn from the same generator as everything else, a blur would change what is drawn after it.
    samples.blurred = lambda roughness, rng: roughness
    teachers = load_cascade("default")
    config = variant.config(steps)
    source = FreshNoise(training_shapes(folder))
    student = Student(config, source, teachers.config.stages[0], teachers.stages[0])
    network, speed = finished(student)
    cascade = Cascade.assembled([(config.stage, network)], RefinementConfig(iterations=0))
    weights = sum(p.numel() for p in network.parameters())
    about = {"weights": weights, "patches_per_second": speed}
    return about | tested(cascade.for_inference(), test_shapes(folder))


def main() -> None:
    """Trains what is not there yet and prints a table; students without a teacher are those of the ablations."""
    options = options_of(__doc__)
    results, steps = options.out / "results.json", options.steps
    print_header("student")
    for width, variant in GROUPS["width"].items():
        if width == "double":
            continue
        alone = f"{'recipe' if variant == Variant() else f'width {width}'}, {steps} steps"
        rows = {
            "no teacher": kept(results, alone, partial(run_ablation, width, steps)),
            "teacher": kept(
                results, f"taught {width}, {steps} steps", partial(measured, variant, steps, options.shapes)
            ),
        }
        for name, row in rows.items():
            print_row(f"{width} width, {name}", row)


def run_ablation(width: str, steps: int) -> dict[str, float]:
    """Says what to run first; the other program keeps weights as well."""
    raise SystemExit(f"{width} width is not there yet: python benches/ablations.py width --steps {steps}")


if __name__ == "__main__":
    main()
