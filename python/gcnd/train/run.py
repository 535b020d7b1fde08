"""A whole training run: shapes, stage after stage, validation, weights; killed at any time, it goes on."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from gcnd import _geom
from gcnd.denoise import denoise_arrays
from gcnd.errors import ConfigError
from gcnd.nn.cascade import Cascade, CascadeConfig, written_out
from gcnd.nn.distributed import first_process_first, process_rank
from gcnd.nn.networks import build_network
from gcnd.predict import fast_precision, predict_normals
from gcnd.train.loop import StepReport, TrainConfig, Trainer
from gcnd.train.pool import DenoisedPool, evaluation_copy, run_stages
from gcnd.weights import save_cascade
from gcnd.weights.files import load_tensors, save_tensors
from gcnd.weights.registry import load_trainable

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import nn

    from gcnd.nn.cascade import StageConfig
    from gcnd.nn.networks import NetworkConfig
    from gcnd.train.corpus import Corpus
    from gcnd.train.recipes import Recipe
    from gcnd.train.samples import CleanShape, VertexSource

CHECKPOINT_SECONDS = 60.0

LOG_EVERY = 100
"""Steps between lines of the log; every line holds the mean loss since the one before."""

N_EXAMPLES = 3


class TrainingRun:
    """One run in one folder; of several processes the first validates, logs and saves.

    Holds ``log.jsonl``, ``stage<i>.checkpoint.safetensors``, ``stage<i>.safetensors`` when a stage is done, and at
    the end ``<name>.safetensors``.
    """

    def __init__(
        self,
        folder: Path,
        recipe: Recipe,
        corpus: Corpus,
        *,
        start_from: str | None = None,
        validate_every: int = 1000,
        device: str = "cpu",
        on_step: Callable[[int, StepReport], None] | None = None,
        on_event: Callable[[str], None] | None = None,
    ):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.recipe, self.corpus, self.device = folder, recipe, corpus, device
        self.validate_every, self.on_step, self.on_event = validate_every, on_step, on_event
        self.is_first = process_rank() == 0
        self.start = None if start_from is None else load_trainable(start_from)

    def run(self) -> Path:
        """Trains every stage that is not done and returns the path of the cascade's weights."""
        trained: list[tuple[StageConfig, nn.Module]] = []
        for index, config in enumerate(self.recipe.stages):
            path = self.folder / f"stage{index + 1}.safetensors"
            if not path.exists():
                state = self._train_stage(index, config, trained)
                with first_process_first():
                    if self.is_first:
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
        if self.is_first:
            save_cascade(out, cascade, {"recipe": self.recipe.name})
            self._save_examples(cascade)
        return out

    def _save_examples(self, cascade: Cascade) -> None:
        """Validation meshes before and after, for the report: ``example-<i>.npz``."""
        ready = cascade.for_inference().to(self.device)
        for number, (shape, noisy) in enumerate(self.corpus.validation[:N_EXAMPLES], start=1):
            denoised = denoise_arrays(noisy, shape.faces, ready, device=self.device)
            np.savez(
                self.folder / f"example-{number}.npz",
                name=shape.name,
                faces=shape.faces,
                clean=shape.vertices,
                noisy=noisy,
                denoised=denoised,
            )

    def _train_stage(
        self, index: int, config: TrainConfig, earlier: list[tuple[StageConfig, nn.Module]]
    ) -> dict[str, torch.Tensor]:
        before = written_out(earlier)
        source = self._source(index, config, before)
        validated = self.corpus.validation if self.is_first else []
        starts = [
            (shape, run_stages(shape, noisy, before, 0, self.device, config.precision))
            for shape, noisy in validated
        ]
        trainer = Trainer(config, source, self._initial_weights(index, config, earlier), self.device)
        checkpoint = self.folder / f"stage{index + 1}.checkpoint.safetensors"
        if checkpoint.exists():
            trainer.load(checkpoint)
            self._say(f"stage {index + 1}: resumed at step {trainer.step}")
        saved, losses = time.monotonic(), []

        def after_step(report: StepReport) -> None:
            nonlocal saved
            if not self.is_first:
                return
            losses.append(report.loss)
            if self.on_step is not None:
                self.on_step(index, report)
            last = report.step == report.steps
            validated = report.step % self.validate_every == 0 or last
            if validated or report.step % LOG_EVERY == 0:
                error = self._validate(trainer, config, starts) if validated else None
                self._log(index, report, float(np.mean(losses)), error)
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
            return self.corpus.source
        self._say(f"stage {index + 1}: denoising {self.recipe.pool_size} meshes with the stages before")
        folder = self.folder / f"stage{index + 1}.pool"
        with first_process_first():
            return DenoisedPool(
                folder,
                self.corpus.source,
                self.corpus.shapes,
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
            return widened(
                self.start.stages[index].state_dict(), self.start.config.stages[index].network, config
            )
        if self.recipe.warm_start and earlier and earlier[-1][0].network == config.stage.network:
            return earlier[-1][1].state_dict()
        return None

    def _validate(
        self, trainer: Trainer, config: TrainConfig, starts: list[tuple[CleanShape, NDArray[np.float64]]]
    ) -> float:
        """Mean E_a of the averaged weights' normals on the validation meshes, in degrees."""
        network = evaluation_copy(trainer.network, trainer.average.state)
        errors = []
        for shape, vertices in starts:
            prediction = predict_normals(shape.topology, vertices, config.stage, network, device=self.device)
            errors.append(float(np.nanmean(_geom.normal_angles(prediction.normals, shape.normals))))
        return float(np.mean(errors))

    def _log(self, stage: int, report: StepReport, loss: float, error: float | None) -> None:
        values = {
            "time": time.time(),
            "stage": stage + 1,
            "step": report.step,
            "loss": loss,
            "patches_per_second": report.patches_per_second,
        }
        if error is not None:
            values["validation_e_a"] = error
            self._say(f"stage {stage + 1}  step {report.step}  loss {loss:.4f}  validation E_a {error:.3f}°")
        with (self.folder / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")

    def _say(self, text: str) -> None:
        if self.on_event is not None and self.is_first:
            self.on_event(text)


def widened(
    state: dict[str, torch.Tensor], network: NetworkConfig, config: TrainConfig
) -> dict[str, torch.Tensor] | None:
    """Fits weights of a network to one of the same layout that may see more channels; ``None`` if it is another.

    The weights of the new channels are zero, so that both networks answer the same.
    """
    wanted = config.stage.network
    if replace(network, in_channels=wanted.in_channels) != wanted or network.in_channels > wanted.in_channels:
        return None
    lack = wanted.in_channels - network.in_channels
    first = "static" if wanted.static_channels else "dynamic"
    names = [f"trunk.{first}.0.{part}.weight" for part in ("center", "neighbor")]
    return state | {name: torch.nn.functional.pad(state[name], (0, lack)) for name in names}


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
