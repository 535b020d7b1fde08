"""The networks' kernels; see `fuzz_cases`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import wild
from fuzz_checks import CORE_REFUSALS, refusals
from wild import Rng

from gcnd import _geom

KERNELS = ("gather_max", "gather_max_argmax", "gather_max_backward", "gather_sum", "gather_sum_backward",
           "edge_max_leaky", "pool_nodes", "pool_nodes_backward", "knn")  # fmt: skip


def kernel(name: str, rng: Rng, _: Path) -> bool:
    """Sizes that fit or not, any index; the memory around every output must stay as it is."""
    p, n, c, k = (wild.below(rng, high) for high in (5, 12, 9, 5))
    dtype = rng.choice([np.float32, np.int16])

    def values(*shape: int) -> Any:
        drawn = rng.normal(size=shape) * rng.choice([1.0, 1.0, 1e30])
        if drawn.size and rng.random() < 0.2:
            drawn.flat[wild.below(rng, drawn.size)] = wild.number(rng)
        with np.errstate(over="ignore"):
            return (
                (drawn.astype(np.float32).view(np.uint32) >> 16).astype(np.uint16).view(np.int16)
                if (dtype == np.int16)
                else drawn.astype(np.float32)
            )

    whole: list[Any] = []

    def output(kind: Any, *shape: int) -> Any:
        if rng.random() < 0.08 and shape:
            shape = (*shape[:-1], max(0, shape[-1] + int(rng.choice([-1, 1]))))
        size = int(np.prod(shape))
        whole.append(np.full(size + 64, 99, dtype=kind))
        return whole[-1][32 : 32 + size].reshape(shape)

    high = n + (n == 0)
    near = rng.integers(0, high, size=(p, n, k)).astype(np.int32)
    if near.size and rng.random() < 0.15:
        near.flat[wild.below(rng, near.size)] = rng.choice([-1, n, 2**31 - 1, -(2**31)])
    winners = rng.integers(0, high, size=(p, n, c)).astype(np.int16)
    if winners.size and rng.random() < 0.15:
        winners.flat[wild.below(rng, winners.size)] = rng.choice([-1, n, 2**15 - 1])
    if rng.random() < 0.05:
        near = near[:, :, :1].copy()
    calls: dict[str, Callable[[], None]] = {
        "gather_max": lambda: _geom.gather_max(values(p, n, c), near, output(dtype, p, n, c)),
        "gather_max_argmax": lambda: _geom.gather_max_argmax(
            values(p, n, c), near, output(dtype, p, n, c), output(np.int16, p, n, c)
        ),
        "gather_max_backward": lambda: _geom.gather_max_backward(
            values(p, n, c), winners, output(dtype, p, n, c)
        ),
        "gather_sum": lambda: _geom.gather_sum(values(p, n, c), near, output(dtype, p, n, c)),
        "gather_sum_backward": lambda: _geom.gather_sum_backward(
            values(p, n, c), near, output(dtype, p, n, c)
        ),
        "edge_max_leaky": lambda: _geom.edge_max_leaky(
            values(p, n, 2 * c), rng.normal(size=c).astype(np.float32), near, 0.2, output(dtype, p, n, c)
        ),
        "pool_nodes": lambda: _geom.pool_nodes(
            values(p, n, c), output(dtype, p, 2 * c), output(np.int16, p, c)
        ),
        "pool_nodes_backward": lambda: _geom.pool_nodes_backward(
            values(p, 2 * c),
            np.ascontiguousarray(winners[:, 0] if n else np.zeros((p, c), np.int16)),
            output(dtype, p, n, c),
        ),
        "knn": lambda: _geom.knn(values(p, n, c), output(np.int32, p, n, k)),
    }
    try:
        with refusals(*CORE_REFUSALS):
            calls[name]()
    finally:
        for buffer in whole:
            assert (buffer[:32] == 99).all(), "memory before an output was written to"
            assert (buffer[-32:] == 99).all(), "memory behind an output was written to"
    return True
