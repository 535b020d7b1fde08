"""`gcnd train`: weights made again from nothing, or from your own meshes."""

from __future__ import annotations

import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gcnd.cli.denoise import Device

if TYPE_CHECKING:
    from collections.abc import Callable

    from gcnd.train.corpus import Corpus
    from gcnd.train.loop import StepReport
    from gcnd.train.recipes import Recipe

__all__ = ["run"]

_SECONDS_BETWEEN_LINES = 10.0


def run(
    preset: Annotated[
        str, typer.Option(help="Recipe: default, fast, paper, scan or paper-scan.")
    ] = "default",
    out: Annotated[Path | None, typer.Option(help="Folder of the run; resumed when it exists.")] = None,
    meshes: Annotated[
        Path | None, typer.Option(help="Folder of clean meshes to train on beside the procedural shapes.")
    ] = None,
    pairs: Annotated[
        Path | None,
        typer.Option(
            help="Dataset of noisy and clean meshes to train on instead: train/noisy, train/original, test/noisy, "
            "test/original."
        ),
    ] = None,
    shapes: Annotated[
        Path | None, typer.Option(help="Folder that keeps procedural shapes between runs.")
    ] = None,
    start_from: Annotated[
        str | None, typer.Option(help="Preset or weights file to start from instead of from nothing.")
    ] = None,
    scale: Annotated[float, typer.Option(min=0.0, help="Factor on the recipe's optimiser steps.")] = 1.0,
    most_stages: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="After the recipe's stages, train more like the last, up to this many in all, while each lowers the "
            "validation error by 1 %.",
            show_default="the recipe's",
        ),
    ] = None,
    precision: Annotated[
        str | None,
        typer.Option(help="float32 or bfloat16; by default bfloat16 where the processor computes in it."),
    ] = None,
    device: Annotated[Device, typer.Option(help="Where to train.")] = Device.CPU,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of torch; by default all cores.")
    ] = None,
) -> None:
    """Train a recipe's weights; killed at any time, the same command goes on."""
    import torch

    from gcnd.errors import ConfigError
    from gcnd.mesh_io import check_output_path
    from gcnd.nn.distributed import process_group
    from gcnd.train.corpus import generated_corpus, paired_corpus, scanned_corpus
    from gcnd.train.recipes import get_recipe
    from gcnd.train.run import adapted
    from gcnd.weights.registry import checked_device

    if threads is not None:
        torch.set_num_threads(threads)
    if meshes is not None and not meshes.is_dir():
        raise ConfigError(f"{meshes} is not a folder of meshes")
    if pairs is not None and (meshes is not None or shapes is not None):
        raise ConfigError("--pairs trains on the pairs alone", hint="leave out --meshes and --shapes")
    if pairs is not None and not pairs.is_dir():
        raise ConfigError(f"{pairs} is not a folder of pairs")
    recipe = adapted(get_recipe(preset), scale=scale, precision=precision, device=device.value)
    if most_stages is not None:
        if most_stages < len(recipe.stages):
            raise ConfigError(
                f"most_stages is {most_stages}, but {preset} has {len(recipe.stages)} of its own"
            )
        recipe = replace(recipe, most_stages=most_stages)
    folder = out or Path("runs") / recipe.name
    weights = folder / f"{recipe.name}.safetensors"
    if start_from is not None and folder.is_dir():
        check_output_path(weights, start_from, is_mesh=False)

    def corpus() -> Corpus:
        if pairs:
            return paired_corpus(pairs)
        shape_folder = shapes or folder / "shapes"
        if recipe.data == "scans":
            return scanned_corpus(recipe, shape_folder, meshes, folder / "scans", on_event=_say)
        return generated_corpus(recipe, shape_folder, meshes, on_event=_say)

    with process_group(checked_device(device.value)) as own_device:
        _train(folder, recipe, corpus, start_from, str(own_device))


def _train(
    folder: Path, recipe: Recipe, make_corpus: Callable[[], Corpus], start_from: str | None, device: str
) -> None:
    from gcnd.formats.lock import only_writer
    from gcnd.nn.distributed import check_shared, first_process_first, process_rank
    from gcnd.train.run import TrainingRun

    check_shared(folder)
    with only_writer(folder) if process_rank() == 0 else nullcontext():
        with first_process_first():
            corpus = make_corpus()
        training = TrainingRun(
            folder,
            recipe,
            corpus,
            start_from=start_from,
            device=device,
            on_step=_LineWriter(),
            on_event=_say,
        )
        try:
            weights = training.run()
        except KeyboardInterrupt:
            _say("stopped; the same command goes on from the last checkpoint, at most a minute ago")
            raise
    if training.is_first:
        print(weights)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class _LineWriter:
    """Prints a line with step, speed, loss and time left every few seconds."""

    def __init__(self) -> None:
        self.last = 0.0

    def __call__(self, stage: int, report: StepReport) -> None:
        now = time.monotonic()
        if now - self.last < _SECONDS_BETWEEN_LINES and report.step < report.steps:
            return
        self.last = now
        error = "" if report.validation is None else f"validation E_a {report.validation:.3f}°  "
        print(
            f"stage {stage + 1}  step {report.step}/{report.steps}  {report.patches_per_second:.0f} patches/s  "
            f"loss {report.loss:.4f}  {error}{report.seconds_left / 60:.1f} min left",
            file=sys.stderr,
            flush=True,
        )
