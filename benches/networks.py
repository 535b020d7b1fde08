"""Patches/s of the networks with the native kernels against plain torch, side by side in one run, as JSON.

    python benches/networks.py                    # all
    python benches/networks.py "default next"     # one of paper first, paper next, default first, default next

The two alternate, and the best of several rounds counts, so that a busy machine disturbs both alike.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from itertools import pairwise

import torch
from torch import Tensor, nn

from gcnd.nn.fold import folded
from gcnd.nn.networks import PAPER_FIRST, PAPER_NEXT, NetworkConfig, build_network
from gcnd.nn.ops import gather, knn, plain_torch
from gcnd.train.recipes import RECIPES

N_PATCHES, N_NODES, ROUNDS = 128, 64, 5


class PlainEdgeConv(nn.Module):
    """EdgeConv as its formula is usually written in torch: one linear layer an edge, BatchNorm, LeakyReLU, max."""

    def __init__(self, in_channels: int, out_channels: int, knn_k: int | None):
        super().__init__()
        self.linear = nn.Linear(2 * in_channels, out_channels, bias=False)
        self.norm = nn.BatchNorm1d(out_channels)
        self.knn_k = knn_k

    def forward(self, x: Tensor, neighbors: Tensor | None = None) -> Tensor:
        """Maps (P, N, C) to (P, N, C')."""
        if self.knn_k is not None:
            neighbors = knn(x, self.knn_k)
        assert neighbors is not None
        center = x.unsqueeze(2).expand(-1, -1, neighbors.shape[-1], -1)
        edges = self.linear(torch.cat([center, gather(x, neighbors) - center], dim=-1))
        shape = edges.shape
        edges = self.norm(edges.view(-1, shape[-1])).view(shape)
        return nn.functional.leaky_relu(edges, 0.2).amax(dim=2)


def plain(config: NetworkConfig) -> nn.Module:
    """The network of ``config`` with every EdgeConv replaced by the plain form."""
    network = build_network(config)
    widths = (config.in_channels, *config.static_channels, *config.dynamic_channels)
    n_static = len(config.static_channels)
    layers = [
        PlainEdgeConv(a, b, None if i < n_static else config.knn_k)
        for i, (a, b) in enumerate(pairwise(widths))
    ]
    network.trunk.static = nn.ModuleList(layers[:n_static])
    network.trunk.dynamic = nn.ModuleList(layers[n_static:])
    return network


def best(calls: dict[str, Callable[[], None]]) -> dict[str, float]:
    """Best seconds of each call over alternating rounds."""
    seconds = dict.fromkeys(calls, float("inf"))
    for call in calls.values():
        call()
    for _ in range(ROUNDS):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            seconds[name] = min(seconds[name], time.perf_counter() - started)
    return seconds


def compare(config: NetworkConfig) -> dict[str, dict[str, float]]:
    """Patches/s of inference and of a training step, native and plain, and their ratio."""
    features = torch.randn(N_PATCHES, N_NODES, config.in_channels)
    neighbors = torch.randint(0, N_NODES, (N_PATCHES, N_NODES, 3), dtype=torch.int32)
    ours, theirs = build_network(config), plain(config)
    fused = folded(build_network(config).eval())

    def infer(network: nn.Module, context: Callable[[], object]) -> Callable[[], None]:
        def call() -> None:
            with torch.inference_mode(), context():  # type: ignore[attr-defined]
                network.eval()(features, neighbors)

        return call

    def train(network: nn.Module, context: Callable[[], object], low: bool = False) -> Callable[[], None]:
        optimizer = torch.optim.AdamW(network.parameters(), lr=1e-4, fused=True)

        def call() -> None:
            with context():  # type: ignore[attr-defined]
                with torch.autocast("cpu", dtype=torch.bfloat16, enabled=low):
                    loss = network.train()(features, neighbors).float().square().mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()

        return call

    result = {}
    for task, calls in {
        "inference": {"native": infer(fused, nullcontext), "plain": infer(theirs, plain_torch)},
        "training": {
            "native": train(ours, nullcontext),
            "plain": train(theirs, plain_torch),
            "native_bfloat16": train(ours, nullcontext, low=True),
        },
    }.items():
        seconds = best(calls)
        speeds = {name: round(N_PATCHES / s, 1) for name, s in seconds.items()}
        result[task] = {**speeds, "ratio": round(speeds["native"] / speeds["plain"], 2)}
    return result


def main() -> None:
    """Compares every network, or those named, and prints JSON."""
    table = {}
    first, further = (stage.stage.network for stage in RECIPES["default"].stages)
    networks = {
        "paper first": PAPER_FIRST,
        "paper next": PAPER_NEXT,
        "default first": first,
        "default next": further,
    }
    for name in sys.argv[1:] or networks:
        table[name] = compare(networks[name])
        print(name, table[name], file=sys.stderr, flush=True)
    print(
        json.dumps(
            {"threads": torch.get_num_threads(), "patches": N_PATCHES, "patches_per_s": table}, indent=1
        )
    )


if __name__ == "__main__":
    main()
