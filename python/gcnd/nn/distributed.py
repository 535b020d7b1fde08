"""What several processes that train one network share; with one process everything here does nothing.

Every process works on its own part of a batch. Means over the batch, as BatchNorm needs them, are taken over all
processes, so that the gradients are those of one process on the whole batch.
"""

from __future__ import annotations

import gc
import os
import secrets
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch import distributed as dist

from gcnd.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


_VARIABLES = ("RANK", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT")

_PATIENCE = timedelta(hours=12)
"""How long processes wait for each other: the first one makes shapes and denoises meshes while the others wait."""


def n_processes() -> int:
    """Returns how many processes train together."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def process_rank() -> int:
    """Returns which of them this is; the first one, 0, also validates, logs and saves."""
    return dist.get_rank() if n_processes() > 1 else 0


def mean_over_processes(x: Tensor) -> Tensor:
    """Averages a tensor over all processes; gradients flow back to every one of them."""
    if n_processes() == 1:
        return x
    from torch.distributed.nn.functional import all_reduce

    total: Tensor = all_reduce(x)  # type: ignore[no-untyped-call]
    return total / n_processes()


@contextmanager
def first_process_first() -> Iterator[None]:
    """Lets the first process through before the others, which then find on disk what it made."""
    if process_rank() > 0:
        dist.barrier()
    yield
    if n_processes() > 1 and process_rank() == 0:
        dist.barrier()


def check_shared(folder: Path) -> None:
    """Checks that all processes see one folder: the first one writes there what the others read.

    Raises:
        ConfigError: A process, on another machine, sees another folder of that name.
    """
    if n_processes() == 1:
        return
    folder.mkdir(parents=True, exist_ok=True)
    told = [secrets.token_hex(16)]
    dist.broadcast_object_list(told)
    mark = folder / f".shared-{told[0]}"
    if process_rank() == 0:
        mark.touch()
    dist.barrier()
    seen: list[bool] = [False] * n_processes()
    dist.all_gather_object(seen, mark.exists())
    if process_rank() == 0:
        mark.unlink()
    if not all(seen):
        blind = ", ".join(str(rank) for rank, sees in enumerate(seen) if not sees)
        raise ConfigError(
            f"{folder} is not one folder for all processes: {blind} of {n_processes()} see another",
            hint="give a folder with --out that all machines share",
        )


@contextmanager
def process_group(device: torch.device) -> Iterator[torch.device]:
    """Joins the processes that torchrun started, and gives this one's device; alone, it gives ``device``.

    Raises:
        ConfigError: More processes on this machine than CUDA devices, or a part of torchrun's environment only.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield device
        return
    missing = [name for name in _VARIABLES if name not in os.environ]
    if missing:
        raise ConfigError(
            f"WORLD_SIZE is set, but not {', '.join(missing)}",
            hint="start several processes with torchrun, or unset WORLD_SIZE",
        )
    if device.type == "cuda":
        local_rank, n_devices = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
        if local_rank >= n_devices:
            raise ConfigError(
                f"process {local_rank} of this machine has no CUDA device of its own, there are {n_devices}",
                hint=f"torchrun --nproc-per-node {n_devices}",
            )
        device = torch.device("cuda", local_rank)
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=_PATIENCE)
    try:
        yield device
    finally:
        # What shares gradients holds the group in cycles, and would end it, threads and all, while the process exits.
        gc.collect()
        dist.destroy_process_group()
