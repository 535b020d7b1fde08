"""Random patch graphs and small networks that the tests of `gcnd.nn` share."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from gcnd.nn.networks import PAPER_NEXT, NetworkConfig

SMALL_NODES = NetworkConfig("nodes", 17, (12, 16), (16, 20), 24, (20, 12), 5, "node")
SMALL_CENTRE = replace(
    PAPER_NEXT,
    static_channels=(12, 16),
    dynamic_channels=(16, 20),
    pool_channels=24,
    head_channels=(20, 12),
    knn_k=5,
)


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def random_values(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=generator(seed))


def random_neighbors(n_patches: int, n_nodes: int, k: int, seed: int = 1) -> Tensor:
    """Any node may be named, also twice: repeated and missing neighbours look like that."""
    return torch.randint(n_nodes, (n_patches, n_nodes, k), dtype=torch.int32, generator=generator(seed))


def random_patches(config: NetworkConfig, n_patches: int = 4, n_nodes: int = 32) -> tuple[Tensor, Tensor]:
    """Features (P, N, C) and static neighbours (P, N, 3)."""
    return (
        random_values(n_patches, n_nodes, config.in_channels, seed=2),
        random_neighbors(n_patches, n_nodes, 3),
    )


def signed_scales(network: nn.Module) -> None:
    """Gives every BatchNorm scales of both signs, some zero, and shifts."""
    for norm in network.modules():
        if isinstance(norm, nn.BatchNorm1d):
            ramp = torch.linspace(-1.3, 1.7, norm.num_features)
            ramp[norm.num_features // 2] = 0.0
            with torch.no_grad():
                norm.weight.copy_(ramp.to(norm.weight.dtype))
                norm.bias.copy_(0.3 * torch.flip(ramp, (0,)).to(norm.bias.dtype))
