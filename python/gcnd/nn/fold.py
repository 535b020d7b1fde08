"""Inference form of the networks: BatchNorm folded in, few products, each EdgeConv one linear layer and one kernel.

LeakyReLU(BatchNorm(W x)) = LeakyReLU((s ∘ W) x + t) with BatchNorm's evaluation map y = s x + t. Exact but for
rounding; a test compares both forms.
"""

from __future__ import annotations

import copy
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gcnd.nn.layers import DynamicEdgeConv, EdgeConv
from gcnd.nn.networks import NORMAL, CentreNormalNet, DenseNorm, GraphTrunk, NodeNormalNet
from gcnd.nn.ops import edge_max_leaky, knn, pool_nodes
from gcnd.nn.transformer import TransformedNet

Precision = Literal["float32", "bfloat16"]


class FoldedEdgeConv(nn.Module):
    """EdgeConv in evaluation mode: one linear layer a node, then one gather, maximum and LeakyReLU.

    LeakyReLU(s (a_i + max_j b_j) + t) = LeakyReLU(a'_i + s max_j b_j) with a' = s a + t. Order "edge" takes the
    maximum of s b_j instead: the scale moves into the linear layer, and 1 is left.
    """

    def __init__(self, layer: EdgeConv):
        super().__init__()
        scale, shift = (x.detach() for x in layer.norm.scale_and_shift())
        self.slope = layer.slope
        self.knn_k = layer.knn_k if isinstance(layer, DynamicEdgeConv) else None
        inside, outside = (
            (scale, torch.ones_like(scale)) if layer.order == "edge" else (torch.ones_like(scale), scale)
        )
        weights = [layer.center.weight * scale[:, None], layer.neighbor.weight * inside[:, None]]
        self.parts = _linear(torch.cat(weights), torch.cat([shift, torch.zeros_like(shift)]))
        self.scale: Tensor
        self.register_buffer("scale", outside)

    def forward(self, x: Tensor, neighbors: Tensor | None = None) -> Tensor:
        """Maps (P, N, C) and, for a static layer, (P, N, K) neighbours to (P, N, C')."""
        if self.knn_k is not None and neighbors is None:
            neighbors = knn(x, self.knn_k)
        assert neighbors is not None
        return edge_max_leaky(self.parts(x), self.scale, neighbors, self.slope)


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


class FoldedTrunk(nn.Module):
    """Static, then dynamic EdgeConv layers; every layer's output side by side."""

    def __init__(self, trunk: GraphTrunk):
        super().__init__()
        self.layers = nn.ModuleList(FoldedEdgeConv(layer) for layer in (*trunk.static, *trunk.dynamic))

    def forward(self, x: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) and (P, N, 3) to (P, N, Σ channels)."""
        outputs = []
        for layer in self.layers:
            x = layer(x, neighbors if layer.knn_k is None else None)
            outputs.append(x)
        return torch.cat(outputs, dim=-1)


class FoldedCentreNet(nn.Module):
    """`CentreNormalNet` for inference."""

    def __init__(self, network: CentreNormalNet):
        super().__init__()
        self.trunk = FoldedTrunk(network.trunk)
        self.pool = FoldedDense(network.pool)
        self.head = nn.Sequential(*(FoldedDense(layer) for layer in network.head))  # type: ignore[arg-type]
        self.out = copy.deepcopy(network.out)

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) float32 features and (P, N, 3) neighbours to (P, 3) float32."""
        x = features.to(self.out.weight.dtype)
        pooled = pool_nodes(self.pool(self.trunk(x, neighbors)))
        out: Tensor = self.out(self.head(pooled)).float()
        return out


class FoldedNodeNet(nn.Module):
    """`NodeNormalNet` for inference; the layer before pooling and the head's first are one linear layer."""

    def __init__(self, network: NodeNormalNet):
        super().__init__()
        pool = FoldedDense(network.pool)
        scale, shift = (x.detach() for x in network.head_norm.scale_and_shift())
        self.slope, self.pool_channels = network.config.slope, network.config.pool_channels
        self.trunk = FoldedTrunk(network.trunk)
        node = network.head_node.weight * scale[:, None]
        self.wide = _linear(
            torch.cat([pool.linear.weight, node]), torch.cat([pool.linear.bias, torch.zeros_like(shift)])
        )
        self.head_patch = _linear(network.head_patch.weight * scale[:, None], shift)
        self.head = nn.Sequential(*(FoldedDense(layer) for layer in network.head))  # type: ignore[arg-type]
        self.out = copy.deepcopy(network.out)

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) float32 features and (P, N, 3) neighbours to (P, N, 3) float32."""
        x = features.to(self.out.weight.dtype)
        wide = self.wide(self.trunk(x, neighbors))
        y, node = wide[..., : self.pool_channels], wide[..., self.pool_channels :]
        pooled = pool_nodes(F.leaky_relu(y, self.slope))
        h = F.leaky_relu(node + self.head_patch(pooled).unsqueeze(1), self.slope, inplace=True)
        residual: Tensor = self.out(self.head(h)).float()
        return features[..., NORMAL] + residual


@torch.no_grad()
def folded(network: nn.Module) -> nn.Module:
    """Returns a network for inference; the original keeps its BatchNorm layers.

    Args:
        network: A trained network of ours, any mode; its running statistics are used. A spatial transformer in front of
            it stays as it is.

    Returns:
        The same interface, evaluation mode, not trainable.

    Choice: docs/choices.md#edgeconv-split.
    """
    twin: nn.Module
    if isinstance(network, TransformedNet):
        twin = TransformedNet(copy.deepcopy(network.transformer), folded(network.network))
    elif isinstance(network, NodeNormalNet):
        twin = FoldedNodeNet(network)
    elif isinstance(network, CentreNormalNet):
        twin = FoldedCentreNet(network)
    else:
        raise TypeError(f"network is a {type(network).__name__}, allowed: what build_network returns")
    return twin.eval().requires_grad_(False)


def for_inference(network: nn.Module, precision: Precision) -> nn.Module:
    """Returns what predicts fastest: BatchNorm folded in, linear layers in a precision.

    Args:
        network: One of ours, folded or not; anything else is returned as it is, but for its linear layers.
        precision: Of the linear layers and of what passes between them; features and normals stay float32.
    """
    if isinstance(network, TransformedNet):
        # Where it turns a patch stays as exact as the features.
        return TransformedNet(network.transformer, for_inference(network.network, precision)).eval()
    if isinstance(network, CentreNormalNet | NodeNormalNet):
        network = folded(network)
    if precision == "float32":
        return network
    twin = copy.deepcopy(network)
    for layer in twin.modules():
        if isinstance(layer, nn.Linear):
            layer.to(getattr(torch, precision))
    return twin


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0], device=weight.device)
    layer.weight = nn.Parameter(weight.detach().clone())
    layer.bias = nn.Parameter(bias.detach().clone())
    return layer
