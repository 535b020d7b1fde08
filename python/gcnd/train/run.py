"""A whole training run: shapes, stage after stage, validation, weights; killed at any time, it goes on."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from gcnd import _geom
from gcnd.data.shape_cache import load_shapes
from gcnd.errors import ConfigError
from gcnd.mesh_io import load, to_arrays
from gcnd.nn.cascade import Cascade, CascadeConfig, written_out
from gcnd.nn.networks import build_network
from gcnd.predict import fast_precision, predict_normals
from gcnd.train.loop import StepReport, TrainConfig, Trainer
from gcnd.train.pool import DenoisedPool, evaluation_copy, run_stages
from gcnd.train.samples import CleanShape, FreshNoise, NoiseDraw, VertexSource, noisy_vertices
from gcnd.weights import save_cascade
from gcnd.weights.files import load_tensors, save_tensors
from gcnd.weights.registry import load_trainable

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import nn

    from gcnd.nn.cascade import StageConfig
    from gcnd.train.recipes import Recipe

VALIDATION_SEED = 1_000_000
"""First seed of the procedural shapes that are validated on and never trained on."""

N_VALIDATION_SHAPES = 6

VALIDATION_NOISE = NoiseDraw("gaussian", 0.2, 0.0, 12345)

CHECKPOINT_SECONDS = 60.0

MESH_WEIGHT = 4.0


class TrainingRun:
    """One run in one folder.

    Holds ``log.jsonl``, ``stage<i>.checkpoint.safetensors``, ``stage<i>.safetensors`` when a stage is done, and at
    the end ``<name>.safetensors``.
    """

    def __init__(
        self,
        folder: Path,
        recipe: Recipe,
        *,
        shape_folder: Path | None = None,
        mesh_folder: Path | None = None,
        start_from: str | None = None,
        validate_every: int = 1000,
        device: str = "cpu",
        on_step: Callable[[int, StepReport], None] | None = None,
        on_event: Callable[[str], None] | None = None,
    ):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.recipe, self.device = folder, recipe, device
        self.validate_every, self.on_step, self.on_event = validate_every, on_step, on_event
        self.shapes = load_clean_shapes(recipe, shape_folder or folder / "shapes", mesh_folder)
        self.validation = [
            CleanShape(s.name, s.kind, s.vertices, s.faces)
            for s in load_shapes(N_VALIDATION_SHAPES, VALIDATION_SEED, shape_folder or folder / "shapes")
        ]
        self.noise = FreshNoise(self.shapes)
        self.start = None if start_from is None else load_trainable(start_from)

    def run(self) -> Path:
        """Trains every stage that is not done and returns the path of the cascade's weights."""
        trained: list[tuple[StageConfig, nn.Module]] = []
        for index, config in enumerate(self.recipe.stages):
            path = self.folder / f"stage{index + 1}.safetensors"
            if not path.exists():
                state = self._train_stage(index, config, trained)
                save_tensors(path, state, {"config": asdict(config)})
            network: nn.Module = build_network(config.stage.network).to(self.device)
            network.load_state_dict(load_tensors(path)[0])
            trained.append((config.stage, network.eval()))
        cascade = Cascade(
            CascadeConfig(tuple(config for config, _ in trained), refinement=self.recipe.refinement)
        )
        for own, (_, network) in zip(cascade.stages, trained, strict=True):
            own.load_state_dict(network.state_dict())
        out = self.folder / f"{self.recipe.name}.safetensors"
        save_cascade(out, cascade, {"recipe": self.recipe.name})
        return out

    def _train_stage(
        self, index: int, config: TrainConfig, earlier: list[tuple[StageConfig, nn.Module]]
    ) -> dict[str, torch.Tensor]:
        before = written_out(earlier)
        source = self._source(index, config, before)
        starts = [self._validation_input(shape, config, before) for shape in self.validation]
        trainer = Trainer(config, source, self._initial_weights(index, config, earlier), self.device)
        checkpoint = self.folder / f"stage{index + 1}.checkpoint.safetensors"
        if checkpoint.exists():
            trainer.load(checkpoint)
            self._say(f"stage {index + 1}: resumed at step {trainer.step}")
        saved, losses = time.monotonic(), []

        def after_step(report: StepReport) -> None:
            nonlocal saved
            losses.append(report.loss)
            if self.on_step is not None:
                self.on_step(index, report)
            last = report.step == report.steps
            if report.step % self.validate_every == 0 or last:
                error = self._validate(trainer, config, starts)
                self._log(
                    stage=index + 1,
                    step=report.step,
                    loss=float(np.mean(losses)),
                    validation_e_a=error,
                    patches_per_second=report.patches_per_second,
                )
                losses.clear()
            if last or time.monotonic() - saved > CHECKPOINT_SECONDS:
                trainer.save(checkpoint)
                saved = time.monotonic()

        trainer.run(after_step)
        return trainer.average.state

    def _source(
        self, index: int, config: TrainConfig, before: list[tuple[StageConfig, nn.Module]]
    ) -> VertexSource:
        if index == 0:
            return self.noise
        self._say(f"stage {index + 1}: denoising {self.recipe.pool_size} meshes with the stages before")
        folder = self.folder / f"stage{index + 1}.pool"
        return DenoisedPool(
            folder,
            self.noise,
            self.shapes,
            before,
            self.recipe.pool_size,
            self.recipe.seed,
            self.device,
            config.precision,
        )

    def _initial_weights(
        self, index: int, config: TrainConfig, earlier: list[tuple[StageConfig, nn.Module]]
    ) -> dict[str, torch.Tensor] | None:
        """Weights of the same stage in ``start_from``, else of the stage before, where layouts agree."""
        if self.start is not None and index < len(self.start.stages):
            same = self.start.config.stages[index].network == config.stage.network
            return self.start.stages[index].state_dict() if same else None
        if self.recipe.warm_start and earlier and earlier[-1][0].network == config.stage.network:
            return earlier[-1][1].state_dict()
        return None

    def _validation_input(
        self, shape: CleanShape, config: TrainConfig, before: list[tuple[StageConfig, nn.Module]]
    ) -> NDArray[np.float64]:
        noisy = noisy_vertices(shape, VALIDATION_NOISE)
        return run_stages(shape, noisy, before, 0, self.device, config.precision)

    def _validate(self, trainer: Trainer, config: TrainConfig, starts: list[NDArray[np.float64]]) -> float:
        """Mean E_a of the averaged weights' normals on the validation shapes, in degrees."""
        network = evaluation_copy(trainer.network, trainer.average.state)
        errors = []
        for shape, vertices in zip(self.validation, starts, strict=True):
            prediction = predict_normals(shape.topology, vertices, config.stage, network, device=self.device)
            errors.append(float(np.nanmean(_geom.normal_angles(prediction.normals, shape.normals))))
        return float(np.mean(errors))

    def _log(self, **values: Any) -> None:
        line = json.dumps({"time": time.time(), **values})
        with (self.folder / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        self._say(line)

    def _say(self, text: str) -> None:
        if self.on_event is not None:
            self.on_event(text)


def load_clean_shapes(recipe: Recipe, shape_folder: Path, mesh_folder: Path | None) -> list[CleanShape]:
    """Makes or reads the procedural shapes of a recipe, and adds the meshes of a folder.

    Subfolders of ``mesh_folder`` named cad, smooth or feature give their meshes that kind; others are "feature".
    A mesh of the folder is drawn as often as `MESH_WEIGHT` generated ones.
    """
    shapes = [
        CleanShape(s.name, s.kind, s.vertices, s.faces)
        for s in load_shapes(recipe.n_shapes, recipe.seed, shape_folder)
    ]
    if mesh_folder is not None:
        for path in sorted(p for p in mesh_folder.rglob("*") if p.suffix in (".ply", ".obj", ".stl", ".off")):
            arrays, _ = to_arrays(load(path))
            kind = path.parent.name if path.parent.name in ("cad", "smooth", "feature") else "feature"
            representatives, welded = _geom.weld(arrays.vertices)
            shapes.append(
                CleanShape(
                    path.stem,
                    kind,
                    arrays.vertices[representatives],
                    welded[arrays.faces],
                    draw_weight=MESH_WEIGHT,
                )
            )
    return shapes


def adapted(recipe: Recipe, *, scale: float = 1.0, precision: str | None = None) -> Recipe:
    """Returns a recipe with ``scale`` times the steps of every stage and a precision that suits the processor.

    ``None`` takes bfloat16 for our recipes where the processor multiplies matrices in it, which is three times as
    fast; the paper's recipe always computes in float32.

    Raises:
        ConfigError: ``precision`` is neither "float32" nor "bfloat16".
    """
    if precision not in (None, "float32", "bfloat16"):
        raise ConfigError(f"precision is {precision!r}, allowed: float32 or bfloat16")
    if precision is None:
        fast = torch.cuda.is_available() or fast_precision("cpu") == "bfloat16"
        precision = "bfloat16" if fast and recipe.name != "paper" else "float32"
    stages = tuple(
        replace(s, steps=max(1, round(s.steps * scale)), precision=precision)  # type: ignore[arg-type]
        for s in recipe.stages
    )
    return replace(recipe, stages=stages)
