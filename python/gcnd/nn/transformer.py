"""The spatial transformer that the paper compares with tensor voting (Sec. 7.5, "GCN with STN")."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gcnd.nn.layers import EdgeConv

_CHANNELS, _HIDDEN = 64, 128


def vector_starts(n_channels: int) -> tuple[int, ...]:
    """Returns the first of the three channels of every vector among a node's features.

    Example:
        >>> vector_starts(17)
        (0, 3, 8, 11, 14)
    """
    # Centroid, normal; area and degree are no vectors; then nines of vectors, and what is said of the whole mesh.
    n_vectors = (n_channels - 8) // 9 * 3
    return (0, 3, *range(8, 8 + 3 * n_vectors, 3))


class SpatialTransformer(nn.Module):
    """Turns the vectors of a patch by a matrix that a small network learns to read from the patch.

    A = I + MLP(max_i EdgeConv(F)_i),  v ↦ v A for each vector v of each node

    It starts at the identity, and nothing keeps A a rotation.

    Paper: Sec. 7.5; after Wang et al. 2019 (DGCNN), Sec. 3.

    Example:
        >>> transformer = SpatialTransformer(8)
        >>> features = torch.randn(2, 64, 8)
        >>> neighbors = torch.zeros(2, 64, 3, dtype=torch.int32)
        >>> torch.equal(transformer(features, neighbors), features)
        True
    """

    def __init__(self, in_channels: int, slope: float = 0.2):
        super().__init__()
        self.edges = EdgeConv(in_channels, _CHANNELS, "node", slope)
        self.hidden = nn.Linear(_CHANNELS, _HIDDEN)
        self.out = nn.Linear(_HIDDEN, 9)
        self.slope = slope
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C) features to (P, N, C), given (P, N, 3) neighbours."""
        pooled = self.edges(features, neighbors).amax(dim=1)
        hidden = F.leaky_relu(self.hidden(pooled), self.slope)
        change = self.out(hidden).to(features.dtype).view(-1, 3, 3)
        matrix = torch.eye(3, dtype=features.dtype, device=features.device) + change
        turned = features.clone()
        for start in vector_starts(features.shape[-1]):
            turned[..., start : start + 3] = features[..., start : start + 3] @ matrix
        return turned


class TransformedNet(nn.Module):
    """A network behind a spatial transformer; its interface is the network's."""

    def __init__(self, transformer: SpatialTransformer, network: nn.Module):
        super().__init__()
        self.transformer, self.network = transformer, network

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C) features and (P, N, 3) neighbours to what the network returns."""
        out: Tensor = self.network(self.transformer(features, neighbors), neighbors)
        return out
