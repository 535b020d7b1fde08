"""Graph convolutions over patch graphs: EdgeConv, static or dynamic (paper Sec. 5.1, Eq. 4).

Shapes: P patches, N nodes a patch, C channels, K neighbours a node. Neighbour ids count inside the patch.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from gcnd.nn.distributed import mean_over_processes, n_processes
from gcnd.nn.ops import gather_max, gather_sum, knn

NormOrder = Literal["edge", "node"]
"""Where BatchNorm and LeakyReLU stand: on every edge before the maximum (the text), or after it (ours)."""


class NodeBatchNorm(nn.BatchNorm1d):
    """Normalises each channel of (P, N, C) features over all nodes of all patches."""

    def forward(self, x: Tensor) -> Tensor:
        """Maps (P, N, C) to (P, N, C)."""
        if self.training and n_processes() > 1:
            return self._over_all_processes(x)
        shape = x.shape
        return super().forward(x.reshape(-1, shape[-1])).view(shape)

    def _over_all_processes(self, x: Tensor) -> Tensor:
        flat = x.reshape(-1, x.shape[-1]).float()
        mean, square = mean_over_processes(torch.stack([flat.mean(0), flat.square().mean(0)]))
        var = (square - mean.square()).clamp_min(0)
        _update_running_statistics(self, mean, var, len(flat) * n_processes())
        scale = self.weight / torch.sqrt(var + self.eps)
        out: Tensor = (x * scale + (self.bias - scale * mean)).to(x.dtype)
        return out

    def scale_and_shift(self) -> tuple[Tensor, Tensor]:
        """Returns the affine map (C), (C) that evaluation mode applies: y = scale · x + shift."""
        assert self.running_mean is not None
        assert self.running_var is not None
        scale = self.weight / torch.sqrt(self.running_var + self.eps)
        return scale, self.bias - scale * self.running_mean


class EdgeConv(nn.Module):
    """Updates each node from its neighbours by the largest edge response.

    F'_i = max_{j ∈ N(i)} h(F_i, F_j − F_i),  h = LeakyReLU(BatchNorm(Linear(·)))        (order "edge")
    F'_i = LeakyReLU(BatchNorm(max_{j ∈ N(i)} Linear(F_i, F_j − F_i)))                     (order "node")

    The linear layer is split: Linear(F_i, F_j − F_i) = (W₁ − W₂) F_i + W₂ F_j + bias = a_i + b_j, so that it
    runs once a node and not once an edge. This is exact. With order "edge" the batch statistics over the edges
    are computed from node sums, and the maximum passes through BatchNorm and LeakyReLU because both are
    monotone; channels with a negative BatchNorm scale take the minimum instead.

    Args:
        in_channels: C of the input.
        out_channels: C of the output.
        order: See ``NormOrder``.
        slope: Negative slope of LeakyReLU.

    Paper: Sec. 5.1, Eq. 4. Choice: docs/choices.md#edgeconv-split.
    """

    def __init__(self, in_channels: int, out_channels: int, order: NormOrder = "node", slope: float = 0.2):
        super().__init__()
        self.order: NormOrder = order
        self.slope = slope
        # The bias is dropped where BatchNorm follows: it would be subtracted again.
        self.center = nn.Linear(in_channels, out_channels, bias=False)  # W₁ − W₂
        self.neighbor = nn.Linear(in_channels, out_channels, bias=False)  # W₂
        self.norm = NodeBatchNorm(out_channels)

    def forward(self, x: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C) features and (P, N, K) int32 neighbours to (P, N, C')."""
        a, b = self.center(x), self.neighbor(x)
        if self.order == "node":
            return nn.functional.leaky_relu(self.norm(a + gather_max(b, neighbors)), self.slope)
        scale, shift = (
            edge_norm_statistics(a, b, neighbors, self.norm) if self.training else self.norm.scale_and_shift()
        )
        # max_j of a channel with a negative scale is the minimum of the raw responses.
        sign = torch.where(self.norm.weight < 0, -1.0, 1.0).to(b.dtype)
        extreme = sign * gather_max(sign * b, neighbors)
        return nn.functional.leaky_relu((a + extreme) * scale + shift, self.slope)


class DynamicEdgeConv(EdgeConv):
    """EdgeConv whose neighbours are the K nearest nodes in feature space, found anew at every call.

    The node itself, at distance zero, is one of the K.

    Paper: Sec. 5.1, "dynamic EdgeConv", K = 8.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        knn_k: int = 8,
        order: NormOrder = "node",
        slope: float = 0.2,
    ):
        super().__init__(in_channels, out_channels, order, slope)
        self.knn_k = knn_k

    def forward(self, x: Tensor, neighbors: Tensor | None = None) -> Tensor:
        """Maps (P, N, C) to (P, N, C'); ``neighbors`` replaces the search where given."""
        return super().forward(x, knn(x, self.knn_k) if neighbors is None else neighbors)


def edge_norm_statistics(
    a: Tensor, b: Tensor, neighbors: Tensor, norm: NodeBatchNorm
) -> tuple[Tensor, Tensor]:
    """Returns BatchNorm's batch affine map (C), (C) over all edge responses a_i + b_j, from node sums alone.

    With ā, b̄ the means over edges (b_j weighted by how many edges end in j), a' = a − ā, b' = b − b̄:
    mean = ā + b̄,  var = E[a'²] + E[b'²] + 2 E[a'_i b'_j], and E[a'_i b'_j] = mean_i a'_i · mean_j b'_j.
    Running statistics of ``norm`` are updated as torch's BatchNorm does.

    Args:
        a: Centre responses (P, N, C).
        b: Neighbour responses (P, N, C).
        neighbors: Node ids in the patch (P, N, K), int32.
        norm: Holds weight, bias, eps, momentum and the running statistics.
    """
    k = neighbors.shape[-1]
    n_edges = a.shape[0] * a.shape[1] * k
    in_degree = torch.zeros(a.shape[:2], dtype=a.dtype, device=a.device)
    flat = neighbors.reshape(neighbors.shape[0], -1).long()
    in_degree.scatter_add_(1, flat, torch.ones_like(flat, dtype=a.dtype))
    weight = in_degree.unsqueeze(-1)
    mean_a, mean_b = mean_over_processes(
        torch.stack([a.mean(dim=(0, 1)), (b * weight).sum(dim=(0, 1)) / n_edges])
    )
    a_centered, b_centered = a - mean_a, b - mean_b
    cross = (a_centered * gather_sum(b_centered, neighbors)).sum(dim=(0, 1)) / n_edges
    var = a_centered.square().mean(dim=(0, 1)) + (b_centered.square() * weight).sum(dim=(0, 1)) / n_edges
    var = mean_over_processes(var + 2 * cross).clamp_min(0)
    mean = mean_a + mean_b
    _update_running_statistics(norm, mean, var, n_edges * n_processes())
    scale = norm.weight / torch.sqrt(var + norm.eps)
    return scale, norm.bias - scale * mean


@torch.no_grad()
def _update_running_statistics(norm: NodeBatchNorm, mean: Tensor, var: Tensor, count: int) -> None:
    assert norm.running_mean is not None
    assert norm.running_var is not None
    assert norm.num_batches_tracked is not None
    norm.num_batches_tracked += 1
    momentum = norm.momentum if norm.momentum is not None else 1.0 / float(norm.num_batches_tracked)
    norm.running_mean.lerp_(mean.to(norm.running_mean.dtype), momentum)
    norm.running_var.lerp_((var * (count / max(count - 1, 1))).to(norm.running_var.dtype), momentum)
