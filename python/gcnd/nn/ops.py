"""Gathers, neighbour search and pooling inside patches: native kernels on the CPU, plain torch elsewhere.

The native kernels work on the tensors' own memory, in float32 and bfloat16, parallel over patches.
Both paths give the same values; gradients too.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from gcnd import _geom

if TYPE_CHECKING:
    from collections.abc import Iterator

_NATIVE_DTYPES = (torch.float32, torch.bfloat16)
_native_enabled = True


@contextmanager
def plain_torch() -> Iterator[None]:
    """Runs the enclosed operations without the native kernels, for tests and side-by-side timing."""
    global _native_enabled
    previous, _native_enabled = _native_enabled, False
    try:
        yield
    finally:
        _native_enabled = previous


def _use_native(x: Tensor) -> bool:
    return _native_enabled and x.device.type == "cpu" and x.dtype in _NATIVE_DTYPES


def _array(x: Tensor) -> Any:
    """Views a contiguous CPU tensor as a numpy array; bfloat16 as its 16-bit patterns."""
    x = x.detach()
    return (x.view(torch.int16) if x.dtype == torch.bfloat16 else x).numpy()


class _GatherMax(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, neighbors: Tensor) -> Tensor:
        values, neighbors = values.contiguous(), neighbors.contiguous()
        out = torch.empty_like(values)
        if not ctx.needs_input_grad[0]:
            _geom.gather_max(_array(values), neighbors.numpy(), _array(out))
            return out
        argmax = torch.empty(values.shape, dtype=torch.int16)
        _geom.gather_max_argmax(_array(values), neighbors.numpy(), _array(out), argmax.numpy())
        ctx.save_for_backward(argmax)
        return out

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor) -> tuple[Tensor, None]:
        (argmax,) = ctx.saved_tensors
        grad_out = grad_out.contiguous()
        grad = torch.empty_like(grad_out)
        _geom.gather_max_backward(_array(grad_out), argmax.numpy(), _array(grad))
        return grad, None


class _GatherSum(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, neighbors: Tensor) -> Tensor:
        values, neighbors = values.contiguous(), neighbors.contiguous()
        out = torch.empty_like(values)
        _geom.gather_sum(_array(values), neighbors.numpy(), _array(out))
        ctx.save_for_backward(neighbors)
        return out

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor) -> tuple[Tensor, None]:
        (neighbors,) = ctx.saved_tensors
        grad_out = grad_out.contiguous()
        grad = torch.empty_like(grad_out)
        _geom.gather_sum_backward(_array(grad_out), neighbors.numpy(), _array(grad))
        return grad, None


class _PoolNodes(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        values = values.contiguous()
        n_patches, _, n_channels = values.shape
        out = torch.empty((n_patches, 2 * n_channels), dtype=values.dtype)
        argmax = torch.empty((n_patches, n_channels), dtype=torch.int16)
        _geom.pool_nodes(_array(values), _array(out), argmax.numpy())
        ctx.save_for_backward(argmax)
        ctx.shape = values.shape
        return out

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor) -> Tensor:
        (argmax,) = ctx.saved_tensors
        grad = torch.empty(ctx.shape, dtype=grad_out.dtype)
        _geom.pool_nodes_backward(_array(grad_out.contiguous()), argmax.numpy(), _array(grad))
        return grad


def gather(values: Tensor, neighbors: Tensor) -> Tensor:
    """Collects the neighbours' features: out[p, i, k] = values[p, neighbors[p, i, k]], (P, N, K, C)."""
    n_patches, n_nodes, k = neighbors.shape
    index = neighbors.reshape(n_patches, n_nodes * k, 1).long().expand(-1, -1, values.shape[-1])
    return values.gather(1, index).view(n_patches, n_nodes, k, values.shape[-1])


def gather_max(values: Tensor, neighbors: Tensor) -> Tensor:
    """Takes the channel-wise maximum over each node's neighbours: out_i = max_{j ∈ N(i)} values_j.

    Args:
        values: Features (P, N, C); float32 or bfloat16 for the native kernel.
        neighbors: Node ids inside the patch (P, N, K), int32.

    Returns:
        (P, N, C). The gradient goes to the neighbour that gave the maximum, the first one on ties.

    Paper: Sec. 5.1, Ψ in Eq. 4.
    """
    if _use_native(values):
        out: Tensor = _GatherMax.apply(values, neighbors)
        return out
    return gather(values, neighbors).max(dim=2).values


def gather_sum(values: Tensor, neighbors: Tensor) -> Tensor:
    """Sums the neighbours' features: out_i = Σ_{j ∈ N(i)} values_j, (P, N, C). See ``gather_max``."""
    if _use_native(values):
        out: Tensor = _GatherSum.apply(values, neighbors)
        return out
    return gather(values, neighbors).sum(dim=2)


def pool_nodes(values: Tensor) -> Tensor:
    """Concatenates mean and maximum over the nodes: (P, N, C) to (P, 2 C).

    The maximum's gradient goes to the node that gave it, the first one on ties.

    Paper: Sec. 5.1, average and max pooling.
    """
    if _use_native(values):
        out: Tensor = _PoolNodes.apply(values)
        return out
    return torch.cat([values.mean(dim=1), values.max(dim=1).values], dim=-1)


@torch.no_grad()
def edge_max_leaky(parts: Tensor, scale: Tensor, neighbors: Tensor, slope: float) -> Tensor:
    """Evaluates an EdgeConv stage from its node parts: out_i = LeakyReLU(a_i + scale · max_{j ∈ N(i)} b_j).

    Args:
        parts: (P, N, 2 C), the centre's part a and then the neighbour's part b of every node.
        scale: (C,), float32.
        neighbors: (P, N, K), int32.
        slope: Negative slope of LeakyReLU.

    Returns:
        (P, N, C), of the parts' dtype; no gradient. Computed in float32.
    """
    if _use_native(parts):
        parts, neighbors = parts.contiguous(), neighbors.contiguous()
        out = torch.empty((*parts.shape[:2], len(scale)), dtype=parts.dtype)
        _geom.edge_max_leaky(_array(parts), _array(scale), neighbors.numpy(), slope, _array(out))
        return out
    a, b = parts.chunk(2, dim=-1)
    response = a.float() + scale * gather_max(b, neighbors).float()
    return torch.nn.functional.leaky_relu(response, slope).to(parts.dtype)


@torch.no_grad()
def knn(features: Tensor, k: int) -> Tensor:
    """Finds the k nearest nodes of each node inside its patch by Euclidean distance of features.

    Args:
        features: (P, N, C).
        k: Neighbours a node, itself included, at most N.

    Returns:
        Node ids (P, N, K), int32, nearest first; ties go to the lower id on the native path.

    Paper: Sec. 5.1, "dynamic EdgeConv".
    """
    if _use_native(features):
        features = features.contiguous()
        out = torch.empty((*features.shape[:2], k), dtype=torch.int32)
        _geom.knn(_array(features), out.numpy())
        return out
    # In bfloat16, autocast's included, the distances of near nodes drown in the rounding of their norms.
    with torch.autocast(features.device.type, enabled=False):
        features = features.float()
        squared = features.square().sum(-1)
        gram = torch.matmul(features, features.transpose(1, 2))
    distance = squared.unsqueeze(2) - 2 * gram + squared.unsqueeze(1)
    return distance.topk(k, dim=-1, largest=False).indices.int()
