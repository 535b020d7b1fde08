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
from gcnd.formats.atomic import write_atomic_npz
from gcnd.nn.cascade import Cascade, written_out
from gcnd.nn.distributed import first_process_first, process_rank
from gcnd.nn.networks import build_network
from gcnd.predict import fast_precision, predict_normals
from gcnd.train.corpus import MADE_BETWEEN_LINES
from gcnd.train.further import Verdict, mean_error, read_verdict, with_further_stages, write_verdict
from gcnd.train.grow import fits, grown
from gcnd.train.identity import check_same_run
from gcnd.train.loop import StepReport, TrainConfig, Trainer, check_settings, load_state
from gcnd.train.pool import DenoisedPool, evaluation_copy, run_stages
from gcnd.weights import save_cascade
from gcnd.weights.files import load_header, load_tensors, save_tensors
from gcnd.weights.registry import load_trainable

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from torch import nn

    from gcnd.nn.cascade import StageConfig
    from gcnd.train.corpus import Corpus
    from gcnd.train.recipes import Recipe
    from gcnd.train.samples import NoisyMesh, VertexSource

CHECKPOINT_SECONDS = 60.0

LOG_EVERY = 100
"""Steps between lines of the log; every line holds the mean loss since the one before."""

N_EXAMPLES = 3

MOST_STEPS = 10**9
"""Of a stage: more is a slip of the keyboard."""


class TrainingRun:
    """One run in one folder; of several processes the first validates, logs and saves.

    Holds ``log.jsonl``, ``stage<i>.pool`` with the meshes of a later stage, ``stage<i>.checkpoint.safetensors``,
    ``stage<i>.safetensors`` when a stage is done, ``stage<i>.json`` with what a further one gained, and at the end
    ``<name>.safetensors`` and ``example-<i>.npz``.

    Args:
        folder: Made if missing; a run that is in there goes on.
        recipe: What to train, and for how long.
        corpus: What to learn from.
        start_from: Preset or weights file whose stages the first stages start from.
        validate_every: Steps between validations.
        device: Where to train.
        on_step: Called with the index of the stage and a report after every step.
        on_event: Called with a line of text when something is worth saying.

    Raises:
        ConfigError: The folder holds a run of other settings, or ``start_from`` has another layout.
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
        self.validation: float | None = None
        if self.is_first:
            check_same_run(folder, recipe, corpus, start_from)

    def run(self) -> Path:
        """Trains every stage that is not done and returns the path of the cascade's weights."""
        trained: list[tuple[StageConfig, nn.Module]] = []
        recipe = self.recipe
        for index, config in enumerate(with_further_stages(recipe.stages, recipe.most_stages)):
            path = self.folder / f"stage{index + 1}.safetensors"
            if path.exists():
                check_settings(path, load_header(path), config)
            else:
                state = self._train_stage(index, config, trained)
                with first_process_first():
                    if self.is_first:
                        save_tensors(path, state, {"config": asdict(config)})
            network: nn.Module = build_network(config.stage.network).to(self.device)
            load_state(network, load_tensors(path)[0], path)
            stage = (config.stage, network.eval())
            if index >= len(recipe.stages) and not self._gains(index, config, trained, stage):
                break
            trained.append(stage)
        cascade = Cascade.assembled(
            trained,
            recipe.refinement,
            recipe.vertex_iterations,
            recipe.keep_detail,
            recipe.flat_passes,
            recipe.pull,
        )
        out = self.folder / f"{self.recipe.name}.safetensors"
        if self.is_first:
            save_cascade(out, cascade, {"recipe": self.recipe.name})
            self._save_examples(cascade)
        return out

    def _gains(
        self,
        index: int,
        config: TrainConfig,
        before: list[tuple[StageConfig, nn.Module]],
        further: tuple[StageConfig, nn.Module],
    ) -> bool:
        """Whether the validation meshes come out better with a further stage; measured once, ``stage<i>.json``."""
        path = self.folder / f"stage{index + 1}.json"
        with first_process_first():
            if self.is_first and not path.exists():
                cascades = (before, [*before, further])
                errors = (mean_error(self._denoised_validation(config, stages)) for stages in cascades)
                write_verdict(path, Verdict(*errors))
            verdict = read_verdict(path)
        self._say(
            f"stage {index + 1}: {verdict.before:.3f}° without it, {verdict.after:.3f}° with it; "
            + ("it stays" if verdict.is_better else "it is left out, and the cascade is done")
        )
        return verdict.is_better

    def _denoised_validation(
        self, config: TrainConfig, stages: list[tuple[StageConfig, nn.Module]]
    ) -> list[NoisyMesh]:
        """The validation meshes after some stages, every pass with its vertex updates, before refinement."""
        passes, iterations = written_out(stages), self.recipe.vertex_iterations
        return [
            run_stages(mesh, passes, 0, self.device, config.precision, iterations)
            for mesh in self.corpus.validation
        ]

    def _save_examples(self, cascade: Cascade) -> None:
        """Validation meshes before and after, for the report: ``example-<i>.npz``."""
        ready = cascade.for_inference().to(self.device)
        for number, (shape, noisy, _, _) in enumerate(self.corpus.validation[:N_EXAMPLES], start=1):
            denoised = denoise_arrays(noisy, shape.faces, ready, device=self.device)
            write_atomic_npz(
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
        source = self._source(index, config, written_out(earlier))
        starts = self._denoised_validation(config, earlier) if self.is_first else []
        self.validation = None
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
                self.on_step(index, replace(report, validation=self.validation))
            last = report.step == report.steps
            validated = report.step % self.validate_every == 0 or last
            if validated or report.step % LOG_EVERY == 0:
                error = self._validate(trainer, config, starts) if validated else None
                self.validation = self.validation if error is None else error
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
                self._pool_seed(index),
                self.device,
                config.precision,
                self.recipe.vertex_iterations,
                self._tell_pool,
                self._own_passes(index, config.stage),
            )

    def _pool_seed(self, index: int) -> int:
        """Of a pool's noise: a stage beyond the recipe's is not to learn from what the last one knows by heart."""
        seed = self.recipe.seed
        return seed if index < len(self.recipe.stages) else seed + index

    def _own_passes(self, index: int, stage: StageConfig) -> list[tuple[StageConfig, nn.Module]]:
        """All passes of a stage but the last, by the weights that it starts from, if they are its own."""
        if self.start is None or index >= len(self.start.stages):
            return []
        network = build_network(stage.network).to(self.device)
        network.load_state_dict(
            grown(self.start.stages[index].state_dict(), self.start.config.stages[index], stage)
        )
        own: list[tuple[StageConfig, nn.Module]] = [(stage, network.eval())]
        return written_out(own)[:-1]

    def _tell_pool(self, made: int, total: int) -> None:
        if made % MADE_BETWEEN_LINES == 0 or made == total:
            self._say(f"pool: {made} of {total} denoised")

    def _initial_weights(
        self, index: int, config: TrainConfig, earlier: list[tuple[StageConfig, nn.Module]]
    ) -> dict[str, torch.Tensor] | None:
        """Weights of the same stage in ``start_from``, else of the stage before, where they fit."""
        if self.start is not None and index < len(self.start.stages):
            given = self.start.config.stages[index]
            return grown(self.start.stages[index].state_dict(), given, config.stage)
        if self.recipe.warm_start and earlier and fits(earlier[-1][0], config.stage):
            return grown(earlier[-1][1].state_dict(), earlier[-1][0], config.stage)
        return None

    def _validate(self, trainer: Trainer, config: TrainConfig, starts: list[NoisyMesh]) -> float:
        """Mean E_a of the averaged weights' normals on the validation meshes, in degrees."""
        network = evaluation_copy(trainer.network, trainer.average.state)
        errors = []
        for shape, vertices, roughness, first in starts:
            prediction = predict_normals(
                shape.topology,
                vertices,
                config.stage,
                network,
                roughness=roughness,
                first=first,
                device=self.device,
            )
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
        append_line(self.folder / "log.jsonl", json.dumps(values))

    def _say(self, text: str) -> None:
        if self.on_event is not None and self.is_first:
            self.on_event(text)


def append_line(path: Path, line: str) -> None:
    """Appends a line to a file, in place of what a kill may have left of the last one."""
    with path.open("ab+") as file:
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)
        file.write(line.encode() + b"\n")


def adapted(
    recipe: Recipe, *, scale: float = 1.0, precision: str | None = None, device: str = "cpu"
) -> Recipe:
    """Returns a recipe with ``scale`` times the steps of every stage and a precision that suits the processor.

    ``None`` takes bfloat16 for our recipes where the device multiplies matrices in it, which is 1.8 times as fast on a
    processor that does (docs/benchmarks.md#networks); the paper's recipes always compute in float32.

    Raises:
        ConfigError: ``precision`` is neither "float32" nor "bfloat16", or ``scale`` is no number above 0 that leaves at
            most 10⁹ steps.
    """
    most = max(stage.steps for stage in recipe.stages)
    if not 0 < scale * most <= MOST_STEPS:
        raise ConfigError(f"scale is {scale}, allowed: above 0, up to {MOST_STEPS / most:,.0f}")
    if precision not in (None, "float32", "bfloat16"):
        raise ConfigError(f"precision is {precision!r}, allowed: float32 or bfloat16")
    if precision is None:
        on_cuda = torch.device(device).type == "cuda"
        fast = torch.cuda.is_bf16_supported() if on_cuda else fast_precision("cpu") == "bfloat16"
        precision = "bfloat16" if fast and not recipe.name.startswith("paper") else "float32"
    stages = tuple(
        replace(s, steps=max(1, round(s.steps * scale)), precision=precision)  # type: ignore[arg-type]
        for s in recipe.stages
    )
    return replace(recipe, stages=stages)
