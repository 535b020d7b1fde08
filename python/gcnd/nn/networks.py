"""The networks: the paper's, which returns the centre's normal, and ours, which returns every node's.

Input of both: features (P, N, C_in) as patch extraction writes them, and static neighbours (P, N, 3), int32.
Channels of the features: centroid (3), normal (3), area, degree, then the vertex offsets (9), the normals of the
scale space (9), the normals before the first pass (9) and the roughness of the mesh (4) where present.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gcnd.errors import ConfigError, check_real, check_whole
from gcnd.nn.layers import DynamicEdgeConv, EdgeConv, NodeBatchNorm, NormOrder
from gcnd.nn.ops import pool_nodes
from gcnd.nn.transformer import SpatialTransformer, TransformedNet

NORMAL = slice(3, 6)
"""Where a node's own normal stands among its features."""


MOST_CHANNELS = 1 << 16

Architecture = Literal["centre", "nodes", "transformed-centre", "transformed-nodes"]


@dataclass(frozen=True)
class NetworkConfig:
    """Everything that fixes a network's layout; stored with its weights.

    Attributes:
        architecture: "centre" (the paper's) or "nodes" (ours); "transformed-centre" and "transformed-nodes" are the
            same behind a spatial transformer (an ablation of paper Sec. 7.5).
        in_channels: 8, 9 each for vertex offsets, the scale space and the normals before the first pass, and 4 for the
            roughness of the mesh.
        static_channels: Channels of the static EdgeConv layers (L_e); empty for a dynamic-only network.
        dynamic_channels: Channels of the dynamic EdgeConv layers (L_d); empty for a static-only network.
        pool_channels: Channels of the layer before pooling.
        head_channels: Channels of the hidden fully connected layers (L_l − 1).
        knn_k: Neighbours in dynamic EdgeConv (K).
        norm_order: See ``gcnd.nn.layers.NormOrder``.
        slope: Negative slope of LeakyReLU.
    """

    architecture: Architecture = "nodes"
    in_channels: int = 17
    static_channels: tuple[int, ...] = (32, 64)
    dynamic_channels: tuple[int, ...] = (64, 128)
    pool_channels: int = 256
    head_channels: tuple[int, ...] = (256, 64)
    knn_k: int = 8
    norm_order: NormOrder = "node"
    slope: float = 0.2

    def __post_init__(self) -> None:
        if self.architecture not in get_args(Architecture):
            allowed = ", ".join(get_args(Architecture))
            raise ConfigError(f"architecture is {self.architecture!r}, allowed: {allowed}")
        if self.norm_order not in ("edge", "node"):
            raise ConfigError(f"norm_order is {self.norm_order!r}, allowed: 'edge' or 'node'")
        if self.in_channels not in (8, 12, 17, 21, 26, 30, 35, 39):
            raise ConfigError(f"in_channels is {self.in_channels}, allowed: 8, 12, 17, 21, 26, 30, 35 or 39")
        if not self.static_channels and not self.dynamic_channels:
            raise ConfigError("a network needs at least one static or dynamic layer")
        if not self.head_channels:
            raise ConfigError("head_channels is empty, allowed: one or more layers")
        for name in ("static_channels", "dynamic_channels", "head_channels"):
            for channels in getattr(self, name):
                check_whole(name, channels, 1, MOST_CHANNELS)
        check_whole("pool_channels", self.pool_channels, 1, MOST_CHANNELS)
        check_whole("knn_k", self.knn_k, 1, 512)
        check_real("slope", self.slope, 0.0, 1.0)

    @property
    def predicts_nodes(self) -> bool:
        """Whether the network returns a normal for every node, not only for the centre."""
        return self.architecture.endswith("nodes")

    @property
    def bytes_a_node(self) -> int:
        """What a run of the network takes for a node at most: two float32 for each channel of every layer, 1.4 to 3
        times what was measured (docs/limits.md)."""
        layers = (*self.static_channels, *self.dynamic_channels, self.pool_channels, *self.head_channels)
        return 8 * sum(layers)

    def to_dict(self) -> dict[str, Any]:
        """Returns the configuration as JSON-ready values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> NetworkConfig:
        """Rebuilds a configuration from ``to_dict``; raises ``ConfigError`` on unknown or missing fields."""
        missing = [field.name for field in fields(cls) if field.name not in values]
        if missing:
            raise ConfigError(f"network configuration does not fit: no {', '.join(missing)}")
        try:
            lists: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
            return cls(**lists)
        except TypeError as error:
            raise ConfigError(f"network configuration does not fit: {error}") from error


PAPER_FIRST = NetworkConfig("centre", 8, (64, 128, 128), (256, 256, 256), 1024, (512, 256, 64), 8, "edge")
"""The paper's first network: L_e = 3, L_d = 3, L_l = 4 (Sec. 7.6)."""

PAPER_NEXT = NetworkConfig("centre", 8, (64, 128), (256, 256), 512, (256, 64), 8, "edge")
"""The paper's further networks: L_e = 2, L_d = 2, L_l = 3 (Sec. 7.6)."""


class GraphTrunk(nn.Module):
    """Runs static, then dynamic EdgeConv layers and concatenates what every layer made (paper Sec. 5.1)."""

    def __init__(self, config: NetworkConfig):
        super().__init__()
        self.static, self.dynamic = nn.ModuleList(), nn.ModuleList()
        channels = config.in_channels
        for width in config.static_channels:
            self.static.append(EdgeConv(channels, width, config.norm_order, config.slope))
            channels = width
        for width in config.dynamic_channels:
            self.dynamic.append(
                DynamicEdgeConv(channels, width, config.knn_k, config.norm_order, config.slope)
            )
            channels = width
        self.out_channels = sum(config.static_channels) + sum(config.dynamic_channels)

    def forward(self, x: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) and (P, N, 3) to (P, N, Σ channels)."""
        outputs = []
        for layer in self.static:
            x = layer(x, neighbors)
            outputs.append(x)
        for layer in self.dynamic:
            x = layer(x)
            outputs.append(x)
        return torch.cat(outputs, dim=-1)


class DenseNorm(nn.Module):
    """LeakyReLU(BatchNorm(Linear(x))) over the last dimension."""

    def __init__(self, in_channels: int, out_channels: int, slope: float):
        super().__init__()
        self.linear = nn.Linear(in_channels, out_channels, bias=False)
        self.norm = NodeBatchNorm(out_channels)
        self.slope = slope

    def forward(self, x: Tensor) -> Tensor:
        """Maps (…, C) to (…, C')."""
        return F.leaky_relu(self.norm(self.linear(x)), self.slope)


class CentreNormalNet(nn.Module):
    """The paper's network: static and dynamic EdgeConv, average and max pooling, fully connected layers.

    Returns the centre face's normal in the patch frame, (P, 3), not normalised.

    Paper: Sec. 5.1, Fig. 4; channels in Sec. 7.6. Choice: docs/choices.md#normal-range.
    """

    def __init__(self, config: NetworkConfig):
        super().__init__()
        self.config = config
        self.trunk = GraphTrunk(config)
        self.pool = DenseNorm(self.trunk.out_channels, config.pool_channels, config.slope)
        widths = (2 * config.pool_channels, *config.head_channels)
        self.head = nn.Sequential(*(DenseNorm(a, b, config.slope) for a, b in pairwise(widths)))
        self.out = nn.Linear(widths[-1], 3)

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) features and (P, N, 3) neighbours to (P, 3)."""
        x = self.pool(self.trunk(features, neighbors))
        pooled = pool_nodes(x)
        out: Tensor = self.out(self.head(pooled))
        return out


class NodeNormalNet(nn.Module):
    """Our network: a normal for every node, from the node's features and the pooled features of its patch.

    n̂_i = n_i + MLP([x_i, mean_j y_j, max_j y_j]),  y = LeakyReLU(BatchNorm(Linear(x)))

    The head's first layer is split into a node part and a patch part, which runs once a patch. The last layer
    starts at zero, so that an untrained network returns the input normals. Not normalised; (P, N, 3).

    Choice: docs/choices.md#node-head (supervising every node is worth four times the patches).
    """

    def __init__(self, config: NetworkConfig):
        super().__init__()
        self.config = config
        self.trunk = GraphTrunk(config)
        self.pool = DenseNorm(self.trunk.out_channels, config.pool_channels, config.slope)
        first, *rest = config.head_channels
        self.head_node = nn.Linear(self.trunk.out_channels, first, bias=False)
        self.head_patch = nn.Linear(2 * config.pool_channels, first, bias=False)
        self.head_norm = NodeBatchNorm(first)
        widths = (first, *rest)
        self.head = nn.Sequential(*(DenseNorm(a, b, config.slope) for a, b in pairwise(widths)))
        self.out = nn.Linear(widths[-1], 3)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) features and (P, N, 3) neighbours to (P, N, 3)."""
        x = self.trunk(features, neighbors)
        y = self.pool(x)
        pooled = pool_nodes(y)
        h = self.head_node(x) + self.head_patch(pooled).unsqueeze(1)
        h = F.leaky_relu(self.head_norm(h), self.config.slope)
        residual: Tensor = self.out(self.head(h)).float()
        return features[..., NORMAL].float() + residual


def build_network(config: NetworkConfig) -> CentreNormalNet | NodeNormalNet | TransformedNet:
    """Makes the network that ``config`` describes, with fresh weights from torch's global generator."""
    network = NodeNormalNet(config) if config.predicts_nodes else CentreNormalNet(config)
    if config.architecture.startswith("transformed"):
        return TransformedNet(SpatialTransformer(config.in_channels, config.slope), network)
    return network
