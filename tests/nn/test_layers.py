"""EdgeConv against the formula written out node by node and edge by edge, with torch's own BatchNorm."""

from __future__ import annotations

import copy

import pytest
import torch
from nn_cases import random_neighbors, random_values, signed_scales
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from gcnd.nn import ops
from gcnd.nn.layers import DynamicEdgeConv, EdgeConv, NodeBatchNorm, NormOrder

N_PATCHES, N_NODES, C_IN, C_OUT, K = 3, 10, 5, 7, 4

ORDERS: list[NormOrder] = ["edge", "node"]

orders = pytest.mark.parametrize("order", ORDERS)
dtypes = pytest.mark.parametrize(
    ("dtype", "tolerance"), [(torch.float32, 2e-5), (torch.float64, 1e-12)], ids=["f32", "f64"]
)


class LoopEdgeConv(nn.Module):
    """Eq. 4 as the paper writes it: one linear layer on (F_i, F_j − F_i), edge by edge."""

    def __init__(self, layer: EdgeConv):
        super().__init__()
        second = layer.neighbor.weight.detach()
        first = layer.center.weight.detach() + second
        self.weight = nn.Parameter(torch.cat([first, second], dim=1))
        self.norm = nn.BatchNorm1d(len(first), eps=layer.norm.eps, momentum=layer.norm.momentum)
        self.norm.to(self.weight.dtype).load_state_dict(layer.norm.state_dict())
        self.order, self.slope = layer.order, layer.slope

    def forward(self, x: Tensor, neighbors: Tensor) -> Tensor:
        responses = []
        for patch, rows in zip(x, neighbors.tolist(), strict=True):
            for i, row in enumerate(rows):
                edges = [torch.cat([patch[i], patch[j] - patch[i]]) for j in row]
                responses.append(torch.stack([self.weight @ edge for edge in edges]))
        k = neighbors.shape[-1]
        if self.order == "node":
            nodes = torch.stack([edges.max(dim=0).values for edges in responses])
            out = leaky_relu(self.norm(nodes), self.slope)
        else:
            edges = leaky_relu(self.norm(torch.cat(responses)), self.slope)
            out = torch.stack(
                [edges[start : start + k].max(dim=0).values for start in range(0, len(edges), k)]
            )
        return out.view(*x.shape[:2], -1)


def make_case(order: NormOrder, dtype: torch.dtype) -> tuple[EdgeConv, Tensor, Tensor]:
    torch.manual_seed(3)
    layer = EdgeConv(C_IN, C_OUT, order, slope=0.2).to(dtype)
    signed_scales(layer)
    assert (layer.norm.weight < 0).any()
    assert (layer.norm.weight == 0).any()
    assert (layer.norm.weight > 0).any()
    x = random_values(N_PATCHES, N_NODES, C_IN, seed=4).to(dtype) + 0.5
    return layer, x, random_neighbors(N_PATCHES, N_NODES, K)


def assert_close(found: Tensor, expected: Tensor, tolerance: float) -> None:
    found, expected = found.detach(), expected.detach()
    assert found.shape == expected.shape
    assert (found - expected).abs().max() <= tolerance * max(1.0, float(expected.abs().max()))


@dtypes
@orders
def test_training_mode_and_its_gradients_equal_the_loop(
    order: NormOrder, dtype: torch.dtype, tolerance: float
) -> None:
    layer, x, neighbors = make_case(order, dtype)
    with torch.no_grad():
        layer.norm.weight[layer.norm.weight == 0] = 0.4  # at 0 all edges tie, and which one wins is open
    loop = LoopEdgeConv(layer)
    grad_out = random_values(N_PATCHES, N_NODES, C_OUT, seed=5).to(dtype)
    results = []
    for module in (layer, loop):
        leaf = x.clone().requires_grad_()
        out = module.train()(leaf, neighbors)
        out.backward(grad_out)
        assert leaf.grad is not None
        results.append((out.detach(), leaf.grad))
    (out, grad), (loop_out, loop_grad) = results
    assert_close(out, loop_out, tolerance)
    assert_close(grad, loop_grad, 10 * tolerance)
    # a = (W₁ − W₂) F_i and b = W₂ F_j, so W₁'s gradient is that of a, and W₂'s that of b less that of a.
    first, second = loop.weight.grad.split(C_IN, dim=1)
    assert_close(layer.center.weight.grad, first, 10 * tolerance)
    assert_close(layer.neighbor.weight.grad, first + second, 10 * tolerance)
    assert_close(layer.norm.weight.grad, loop.norm.weight.grad, 10 * tolerance)
    assert_close(layer.norm.bias.grad, loop.norm.bias.grad, 10 * tolerance)


@dtypes
@orders
@pytest.mark.parametrize("momentum", [0.1, None])
def test_running_statistics_and_evaluation_mode_equal_the_loop(
    order: NormOrder, dtype: torch.dtype, tolerance: float, momentum: float | None
) -> None:
    layer, x, neighbors = make_case(order, dtype)
    layer.norm.momentum = momentum
    loop = LoopEdgeConv(layer)
    with torch.no_grad():
        for step in range(3):
            shifted = x * (1 + step) - step
            layer.train()(shifted, neighbors)
            loop.train()(shifted, neighbors)
        assert_close(layer.norm.running_mean, loop.norm.running_mean, tolerance)
        assert_close(layer.norm.running_var, loop.norm.running_var, tolerance)
        assert int(layer.norm.num_batches_tracked) == 3
        assert_close(layer.eval()(x, neighbors), loop.eval()(x, neighbors), tolerance)
        assert int(layer.norm.num_batches_tracked) == 3


@orders
def test_evaluation_mode_has_the_gradients_of_the_loop(order: NormOrder) -> None:
    layer, x, neighbors = make_case(order, torch.float64)
    loop = LoopEdgeConv(layer).eval()
    layer.eval()
    found, expected = (
        torch.autograd.grad(module(leaf, neighbors).square().sum(), leaf)[0]
        for module, leaf in ((layer, x.clone().requires_grad_()), (loop, x.clone().requires_grad_()))
    )
    assert_close(found, expected, 1e-11)


@orders
def test_native_kernels_change_nothing(order: NormOrder) -> None:
    layer, x, neighbors = make_case(order, torch.float32)
    twin = copy.deepcopy(layer)
    native = layer(x, neighbors)
    with ops.plain_torch():
        plain = twin(x, neighbors)
    assert_close(native, plain, 2e-6)
    assert_close(layer.norm.running_var, twin.norm.running_var, 2e-6)


def test_order_edge_takes_the_minimum_where_the_scale_is_negative() -> None:
    layer = EdgeConv(1, 2, "edge", slope=0.5).eval()
    with torch.no_grad():
        layer.center.weight.fill_(0.0)
        layer.neighbor.weight.fill_(1.0)
        layer.norm.weight.copy_(torch.tensor([1.0, -1.0]))
    x = torch.tensor([[[1.0], [3.0], [-2.0]]])
    neighbors = torch.tensor([[[0, 1], [1, 2], [2, 2]]], dtype=torch.int32)
    expected = torch.tensor([[[3.0, -0.5], [3.0, 2.0], [-1.0, 2.0]]])
    assert_close(layer(x, neighbors), expected, 1e-5)


@orders
def test_dynamic_is_static_with_the_nearest_neighbors(order: NormOrder) -> None:
    static, x, _ = make_case(order, torch.float32)
    dynamic = DynamicEdgeConv(C_IN, C_OUT, knn_k=K, order=order, slope=0.2)
    dynamic.load_state_dict(static.state_dict())
    nearest = ops.knn(x, K)
    for mode in (True, False):
        expected = static.train(mode)(x, nearest)
        assert torch.equal(dynamic.train(mode)(x), expected)
        assert torch.equal(dynamic(x, nearest), static(x, nearest))
    other = random_neighbors(N_PATCHES, N_NODES, K)
    assert not torch.equal(dynamic(x, other), dynamic(x))


@orders
def test_dynamic_searches_anew_at_every_call(order: NormOrder) -> None:
    torch.manual_seed(0)
    layer = DynamicEdgeConv(C_IN, C_OUT, knn_k=K, order=order).eval()
    x = random_values(1, N_NODES, C_IN)
    permutation = torch.randperm(N_NODES, generator=torch.Generator().manual_seed(1))
    assert_close(layer(x[:, permutation]), layer(x)[:, permutation], 1e-6)


def test_node_norm_is_torch_batch_norm_over_nodes_and_patches() -> None:
    norm, reference = NodeBatchNorm(C_OUT).double(), nn.BatchNorm1d(C_OUT).double()
    signed_scales(norm)
    reference.load_state_dict(norm.state_dict())
    x = random_values(N_PATCHES, N_NODES, C_OUT).double() * 3 + 1
    assert torch.equal(norm(x), reference(x.view(-1, C_OUT)).view_as(x))
    norm.eval()
    scale, shift = norm.scale_and_shift()
    assert_close(scale * x + shift, norm(x), 1e-14)
