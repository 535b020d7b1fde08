"""What each process of tests/train/test_distributed.py runs."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import distributed as dist
from train_cases import TRAIN, clean, cube, sphere

from gcnd.errors import ConfigError
from gcnd.nn.distributed import check_shared, process_group, process_rank
from gcnd.nn.networks import NetworkConfig
from gcnd.train.loop import TrainConfig, Trainer
from gcnd.train.samples import Batch, FreshNoise

PAPER_LIKE = NetworkConfig("centre", 17, (8,), (8, 12), 16, (12, 8), 4, "edge")


def config_of(name: str) -> TrainConfig:
    """Our network with the chord loss, or the paper's form with BatchNorm on the edges and the squared loss."""
    # Clipping would hide a wrong scale of the gradients.
    config = replace(TRAIN, grad_clip=1e9)
    if name == "nodes":
        return config
    stage = replace(TRAIN.stage, network=PAPER_LIKE, coverage=None)
    return replace(config, stage=stage, loss="mse")


def one_step(name: str, batch: Batch) -> dict[str, torch.Tensor]:
    """Gradients and BatchNorm statistics after one step on a batch."""
    trainer = Trainer(config_of(name), FreshNoise([clean(sphere()), clean(cube())]))
    torch.manual_seed(1)
    for parameter in trainer.network.parameters():
        # The last layer starts at zero, which would hide most gradients.
        torch.nn.init.normal_(parameter, std=0.3)
    trainer._one_step(batch)
    gradients = {f"gradient.{k}": p.grad for k, p in trainer.network.named_parameters() if p.grad is not None}
    statistics = {k: v for k, v in trainer.network.named_buffers() if "running" in k}
    return {**gradients, **statistics}


def resumed_after(folder: Path, step: int) -> bool:
    """Whether a run that was saved after some steps and loaded again ends with the weights of one in a piece."""
    source = FreshNoise([clean(sphere()), clean(cube())])
    straight, first, second = (Trainer(TRAIN, source) for _ in range(3))
    straight.run(lambda report: None)
    first.run(lambda report: None, until=step)
    if process_rank() == 0:
        first.save(folder / "checkpoint.safetensors")
    dist.barrier()
    second.load(folder / "checkpoint.safetensors")
    second.run(lambda report: None)
    whole = straight.network.state_dict()
    return all(torch.equal(tensor, whole[name]) for name, tensor in second.network.state_dict().items())


def what_is_shared(folder: Path) -> str:
    """What is said of a folder that both processes see, and of one that each has for itself."""
    check_shared(folder / "shared")
    try:
        check_shared(folder / f"own {process_rank()}")
    except ConfigError as error:
        return "one folder: ok; own folders: " + str(error).split(": ")[1]
    return "own folders: ok"


def main(folder: Path, name: str) -> None:
    """Takes this process's half of the stored batch and stores what one step makes of it."""
    with process_group(torch.device("cpu")):
        if name == "folders":
            (folder / f"folders.{process_rank()}").write_text(what_is_shared(folder), encoding="utf-8")
            return
        if name == "resume":
            (folder / f"resume.{process_rank()}").write_text(str(resumed_after(folder, 3)), encoding="utf-8")
            return
        whole = load_file(folder / "batch.safetensors")
        half = slice(process_rank(), None, dist.get_world_size())
        batch = Batch(*(whole[field][half].contiguous() for field in Batch._fields))
        save_file(one_step(name, batch), folder / f"{name}.{process_rank()}.safetensors")


if __name__ == "__main__":
    assert "RANK" in os.environ
    main(Path(sys.argv[1]), sys.argv[2])
