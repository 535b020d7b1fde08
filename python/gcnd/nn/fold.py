"""Inference form of the networks: BatchNorm folded into the linear layers, each EdgeConv one fused kernel.

LeakyReLU(BatchNorm(W x)) = LeakyReLU((s ∘ W) x + t) with BatchNorm's evaluation map y = s x + t. Exact but for
rounding; a test compares both forms.
"""

from __future__ import annotations

import copy
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gcnd.nn.layers import DynamicEdgeConv, EdgeConv
from gcnd.nn.networks import CentreNormalNet, DenseNorm, NodeNormalNet
from gcnd.nn.ops import edge_max_leaky, gather_max, knn

Network = TypeVar("Network", CentreNormalNet, NodeNormalNet)


class FoldedEdgeConv(nn.Module):
    """EdgeConv in evaluation mode: two linear layers, then one gather, maximum and LeakyReLU.

    With order "edge" the scale goes into both layers whatever its sign: max_j s (a_i + b_j) = s a_i + max_j s b_j.
    With order "node", s max_j b_j equals max_j s b_j only for s ≥ 0; a layer with a negative scale keeps the
    maximum of the raw responses and applies the scale after it.
    """

    def __init__(self, layer: EdgeConv):
        super().__init__()
        scale, shift = (x.detach() for x in layer.norm.scale_and_shift())
        self.slope = layer.slope
        self.knn_k = layer.knn_k if isinstance(layer, DynamicEdgeConv) else None
        self.center = _linear(layer.center.weight * scale[:, None], shift)
        self.fused = layer.order == "edge" or bool((scale >= 0).all())
        self.neighbor = _linear(layer.neighbor.weight * (scale[:, None] if self.fused else 1.0), None)
        self.scale: Tensor
        self.register_buffer("scale", torch.ones_like(scale) if self.fused else scale)

    def forward(self, x: Tensor, neighbors: Tensor | None = None) -> Tensor:
        """Maps (P, N, C) and, for a static layer, (P, N, K) neighbours to (P, N, C')."""
        if self.knn_k is not None and neighbors is None:
            neighbors = knn(x, self.knn_k)
        assert neighbors is not None
        a, b = self.center(x), self.neighbor(x)
        if self.fused:
            return edge_max_leaky(a, b, neighbors, self.slope)
        return F.leaky_relu(a + self.scale * gather_max(b, neighbors), self.slope)


class FoldedDense(nn.Module):
    """LeakyReLU(Linear(x)), BatchNorm folded in."""

    def __init__(self, layer: DenseNorm):
        super().__init__()
        scale, shift = (x.detach() for x in layer.norm.scale_and_shift())
        self.linear = _linear(layer.linear.weight * scale[:, None], shift)
        self.slope = layer.slope

    def forward(self, x: Tensor) -> Tensor:
        """Maps (…, C) to (…, C')."""
        return F.leaky_relu(self.linear(x), self.slope, inplace=True)


@torch.no_grad()
def folded(network: Network) -> Network:
    """Returns a copy of a network for inference; the original keeps its BatchNorm layers.

    Args:
        network: A trained network, any mode; its running statistics are used.

    Returns:
        The same interface, evaluation mode, not trainable.

    Choice: docs/choices.md#edgeconv-split.
    """
    twin = copy.deepcopy(network).eval()
    twin.trunk.static = nn.ModuleList(FoldedEdgeConv(layer) for layer in twin.trunk.static)  # type: ignore[arg-type]
    twin.trunk.dynamic = nn.ModuleList(FoldedEdgeConv(layer) for layer in twin.trunk.dynamic)  # type: ignore[arg-type]
    twin.pool = FoldedDense(twin.pool)  # type: ignore[assignment]
    twin.head = nn.Sequential(*(FoldedDense(layer) for layer in twin.head))  # type: ignore[arg-type]
    if isinstance(twin, NodeNormalNet):
        scale, shift = twin.head_norm.scale_and_shift()
        twin.head_node = _linear(twin.head_node.weight * scale[:, None], None)
        twin.head_patch = _linear(twin.head_patch.weight * scale[:, None], shift)
        twin.head_norm = nn.Identity()  # type: ignore[assignment]
    return twin.requires_grad_(False)


def _linear(weight: Tensor, bias: Tensor | None) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0], bias=bias is not None, device=weight.device)
    layer.weight = nn.Parameter(weight.detach().clone(), requires_grad=False)
    if bias is not None:
        layer.bias = nn.Parameter(bias.detach().clone(), requires_grad=False)
    return layer
