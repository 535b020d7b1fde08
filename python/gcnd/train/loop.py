"""The training loop of one stage: patches in, weights out, resumable at any step."""

from __future__ import annotations

import json
import math
import threading
import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from queue import Queue
from typing import TYPE_CHECKING, Any, Literal

import torch

from gcnd.errors import ConfigError, WeightsError
from gcnd.nn.cascade import StageConfig
from gcnd.nn.distributed import mean_over_processes, n_processes, process_rank
from gcnd.nn.networks import build_network
from gcnd.train.checkpoint import WeightAverage, optimizer_tensors, restore_optimizer, sub_state
from gcnd.train.losses import LOSSES
from gcnd.train.samples import Batch, ChunkConfig, VertexSource, make_chunk
from gcnd.weights.files import load_tensors, save_tensors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from torch import Tensor, nn


DAMAGED_HINT = "delete it; the run goes on from what is left"


@dataclass(frozen=True)
class TrainConfig:
    """How one stage is trained.

    Attributes:
        stage: Network and patches.
        steps: Optimiser steps; the learning rate has decayed to ``final_lr_ratio`` at the last.
        batch: Patches a step.
        lr: Peak learning rate of AdamW.
        warmup: Steps of linear warm-up before the cosine.
        final_lr_ratio: Learning rate at the end over the peak.
        weight_decay: Of AdamW.
        grad_clip: Largest norm of the gradient.
        ema_decay: See ``WeightAverage``.
        loss: A name in ``gcnd.train.losses.LOSSES``.
        precision: "float32", or "bfloat16" for matrix products and activations.
        chunk: How patches are drawn.
        seed: Of weights and data.
    """

    stage: StageConfig
    steps: int
    batch: int = 256
    lr: float = 2e-3
    warmup: int = 200
    final_lr_ratio: float = 0.01
    weight_decay: float = 1e-4
    grad_clip: float = 1.0
    ema_decay: float = 0.999
    loss: Literal["chord", "mse"] = "chord"
    precision: Literal["float32", "bfloat16"] = "float32"
    chunk: ChunkConfig = field(default_factory=ChunkConfig)
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("batch", "chunk.n_meshes"):
            size = self.batch if name == "batch" else self.chunk.n_meshes
            if size < 1 or self.chunk.n_patches % size:
                raise ConfigError(
                    f"{name} is {size}, which does not divide chunk.n_patches = {self.chunk.n_patches}"
                )


@dataclass(frozen=True)
class StepReport:
    """What the loop says after a step.

    Attributes:
        step: Steps done.
        steps: Steps in all.
        loss: Of this step's batch.
        patches_per_second: Since the loop began.
        seconds_left: At that speed.
        validation: E_a in degrees when the stage was last validated; None before.
    """

    step: int
    steps: int
    loss: float
    patches_per_second: float
    seconds_left: float
    validation: float | None = None


def learning_rate(config: TrainConfig, step: int) -> float:
    """Linear warm-up, then a cosine from ``lr`` to ``final_lr_ratio · lr``."""
    if step < config.warmup:
        return config.lr * (step + 1) / config.warmup
    progress = (step - config.warmup) / max(1, config.steps - config.warmup)
    low = config.final_lr_ratio
    return config.lr * (low + (1 - low) * 0.5 * (1 + math.cos(math.pi * min(1.0, progress))))


def batches(source: VertexSource, config: TrainConfig, first_step: int) -> Iterator[Batch]:
    """Yields this process's part of the batch of every step from ``first_step`` on; one thread makes chunks ahead.

    Process r of n takes chunks r, r + n, r + 2 n, …
    """
    size = config.batch // n_processes()
    per_chunk = config.chunk.n_patches // size
    queue: Queue[Batch | BaseException] = Queue(maxsize=2)
    stop = threading.Event()

    def produce() -> None:
        index = first_step // per_chunk
        while not stop.is_set():
            try:
                number = index * n_processes() + process_rank()
                queue.put(make_chunk(source, config.stage.patch, config.chunk, config.seed, number))
            except BaseException as error:
                queue.put(error)
                return
            index += 1

    producer = threading.Thread(target=produce, daemon=True)
    producer.start()
    skip = first_step % per_chunk
    try:
        while True:
            chunk = queue.get()
            if isinstance(chunk, BaseException):
                raise chunk
            for part in range(skip, per_chunk):
                rows = slice(part * size, (part + 1) * size)
                yield Batch(*(tensor[rows] for tensor in chunk))
            skip = 0
    finally:
        # Waited for: a thread in native code while the interpreter shuts down aborts the process.
        stop.set()
        while producer.is_alive():
            while not queue.empty():
                queue.get_nowait()
            producer.join(timeout=0.05)


def check_settings(path: Path, header: dict[str, Any], config: TrainConfig) -> None:
    """Raises ``ConfigError`` when the file that ``header`` comes from was trained with another configuration."""
    if header.get("config") != json.loads(json.dumps(asdict(config))):
        raise ConfigError(
            f"{path} was trained with other settings",
            hint="give the same settings again, or another folder",
        )


def load_state(network: nn.Module, state: dict[str, Tensor], path: Path) -> None:
    """Loads weights into a network; raises ``WeightsError`` when the file at ``path`` held others."""
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise WeightsError(
            f"{path} does not hold the weights of its network: {str(error).splitlines()[-1].strip()}",
            hint=DAMAGED_HINT,
        ) from error


def _shared(network: nn.Module, device: torch.device) -> nn.Module:
    """The network itself, or what averages its gradients over all processes."""
    if n_processes() == 1:
        return network
    from torch.nn.parallel import DistributedDataParallel

    # BatchNorm's statistics are the same everywhere already.
    ids = [device.index] if device.type == "cuda" else None
    return DistributedDataParallel(network, device_ids=ids, broadcast_buffers=False)


class Trainer:
    """Trains one stage; everything that a resumed run needs is in ``save`` and ``load``."""

    def __init__(
        self,
        config: TrainConfig,
        source: VertexSource,
        initial: dict[str, Tensor] | None = None,
        device: str = "cpu",
    ):
        if config.batch % n_processes():
            raise ConfigError(
                f"a batch of {config.batch} cannot be shared evenly by {n_processes()} processes",
                hint="start a number of processes that divides it",
            )
        torch.manual_seed(config.seed)
        self.config, self.source, self.device = config, source, device
        self.network: nn.Module = build_network(config.stage.network).to(device)
        if initial is not None:
            self.network.load_state_dict(initial)
        self.shared = _shared(self.network, torch.device(device))
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=config.lr, weight_decay=config.weight_decay, fused=True
        )
        self.average = WeightAverage(self.network, config.ema_decay)
        self.step = 0

    def save(self, path: Path, header: dict[str, Any] | None = None) -> None:
        """Writes a checkpoint from which ``load`` goes on bit for bit."""
        tensors = {f"network.{k}": v for k, v in self.network.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.state.items()}
        tensors |= optimizer_tensors(self.optimizer)
        save_tensors(path, tensors, {"step": self.step, "config": asdict(self.config), **(header or {})})

    def load(self, path: Path) -> dict[str, Any]:
        """Restores a checkpoint and returns its header; raises ``ConfigError`` if it has another configuration."""
        tensors, header = load_tensors(path)
        check_settings(path, header, self.config)
        load_state(self.network, sub_state(tensors, "network"), path)
        average = sub_state(tensors, "average")
        step, n_moments = (
            header.get("step"),
            len({k.split(".")[1] for k in tensors if k.startswith("optimizer.")}),
        )
        # The optimiser has none before its first step.
        expected = 0 if step == 0 else len(self.optimizer.param_groups[0]["params"])
        if average.keys() != self.average.state.keys() or not isinstance(step, int) or n_moments != expected:
            raise WeightsError(f"{path} lacks a part of a checkpoint", hint=DAMAGED_HINT)
        self.average.state = {k: v.to(self.device) for k, v in average.items()}
        restore_optimizer(self.optimizer, tensors)
        self.step = step
        return header

    def run(self, after_step: Callable[[StepReport], None], until: int | None = None) -> None:
        """Trains to ``until`` (default: the configured steps), calling ``after_step`` after each step."""
        last = self.config.steps if until is None else min(until, self.config.steps)
        if self.step >= last:
            return
        started, first = time.monotonic(), self.step
        for batch in batches(self.source, self.config, self.step):
            loss = self._one_step(Batch(*(t.to(self.device) for t in batch)))
            speed = (self.step - first) / (time.monotonic() - started)
            after_step(
                StepReport(
                    self.step,
                    self.config.steps,
                    loss,
                    speed * self.config.batch,
                    (self.config.steps - self.step) / speed,
                )
            )
            if self.step >= last:
                return

    def _one_step(self, batch: Batch) -> float:
        self.network.train()
        loss = self.loss_of(batch)
        self.backpropagate(loss)
        self.move_weights()
        return float(mean_over_processes(loss.detach()))

    def loss_of(self, batch: Batch) -> Tensor:
        """Runs the network on a batch and returns its loss."""
        config = self.config
        low = config.precision == "bfloat16"
        kind = torch.device(self.device).type
        with torch.autocast(kind, dtype=torch.bfloat16) if low else nullcontext():
            predicted = self.shared(batch.features, batch.neighbors)
        return LOSSES[config.loss](predicted.float(), batch)

    def backpropagate(self, loss: Tensor) -> None:
        """Replaces the gradients by those of a loss."""
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]

    def move_weights(self) -> None:
        """Takes one step of the optimiser along the present gradients, and the average after it."""
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(self.config, self.step)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.config.grad_clip)
        self.optimizer.step()
        self.step += 1
        self.average.update(self.network, self.step)
