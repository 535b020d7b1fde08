"""A whole training run in small: weights that denoise, and the same weights after any interruption."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from train_cases import STAGE, TRAIN, cube, sphere

from gcnd.data.noise import add_noise
from gcnd.data.shapes import Shape
from gcnd.denoise import denoise
from gcnd.errors import ConfigError
from gcnd.mesh_io import save
from gcnd.train import run as run_module
from gcnd.train.loop import StepReport
from gcnd.train.recipes import RECIPES, Recipe, get_recipe
from gcnd.train.run import TrainingRun, adapted, load_clean_shapes
from gcnd.weights import load_cascade
from gcnd.weights.files import load_tensors

RECIPE = replace(
    get_recipe("default"),
    name="tiny",
    stages=(
        replace(TRAIN, steps=5),
        replace(TRAIN, stage=replace(STAGE, passes=2), steps=4, seed=4),
    ),
    n_shapes=2,
    pool_size=2,
    normal_iterations=3,
)


class KilledError(Exception):
    """Stands for the end of the process."""


@pytest.fixture(autouse=True)
def small_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two small shapes in place of the procedural ones, and a checkpoint after every step."""

    def load_shapes(n: int, seed: int, directory: Path) -> list[Shape]:
        shapes = [sphere(), cube()]
        return shapes[: 1 if seed == run_module.VALIDATION_SEED else n]

    monkeypatch.setattr(run_module, "load_shapes", load_shapes)
    monkeypatch.setattr(run_module, "CHECKPOINT_SECONDS", -1.0)


def run(folder: Path, recipe: Recipe = RECIPE, kill_at: tuple[int, int] | None = None, **options: Any) -> Path:
    """Runs a recipe; with `kill_at`, ends as a killed process would at that (stage, step), nothing saved."""

    def on_step(stage: int, report: StepReport) -> None:
        if (stage, report.step) == kill_at:
            raise KilledError

    return TrainingRun(folder, recipe, validate_every=2, on_step=on_step, **options).run()


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("straight")
    with pytest.MonkeyPatch.context() as patched:
        small_shapes.__wrapped__(patched) if hasattr(small_shapes, "__wrapped__") else None
        patched.setattr(run_module, "load_shapes", lambda n, seed, directory: [sphere(), cube()][:n])
        run(folder)
    return folder


def logged(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]


def assert_same_weights(found: Path, expected: Path) -> None:
    (tensors, header), (wanted, wanted_header) = load_tensors(found), load_tensors(expected)
    assert header == wanted_header
    assert tensors.keys() == wanted.keys()
    assert all(torch.equal(tensors[name], tensor) for name, tensor in wanted.items())
