"""Native kernels against plain torch and against their definitions; gradients of both."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from nn_cases import generator, random_neighbors, random_values
from torch import Tensor
from torch.nn.functional import leaky_relu

from gcnd.errors import ConfigError
from gcnd.nn import ops

SHAPES = [(1, 1, 1, 1), (2, 5, 3, 2), (3, 33, 17, 8), (2, 64, 67, 9), (1, 40, 128, 3)]
"""P, N, C, K: below, at and above the kernels' blocks of 16 and 64 channels and groups of 8 neighbours."""

DTYPES = [torch.float32, torch.bfloat16]

shapes = pytest.mark.parametrize("shape", SHAPES, ids=str)
dtypes = pytest.mark.parametrize("dtype", DTYPES, ids=["f32", "bf16"])


def case(shape: tuple[int, int, int, int], dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    n_patches, n_nodes, n_channels, k = shape
    values = random_values(n_patches, n_nodes, n_channels).to(dtype)
    return values, random_neighbors(n_patches, n_nodes, k)


def whole_numbers(shape: tuple[int, ...], dtype: torch.dtype, limit: int, seed: int = 5) -> Tensor:
    """Numbers whose sums are exact in any order, also in bfloat16."""
    return torch.randint(-limit, limit + 1, shape, generator=generator(seed)).to(dtype)


def with_gradient(
    op: Callable[[Tensor, Tensor], Tensor], values: Tensor, neighbors: Tensor, grad_out: Tensor
) -> tuple[Tensor, Tensor]:
    leaf = values.clone().requires_grad_()
    out = op(leaf, neighbors)
    out.backward(grad_out)
    assert leaf.grad is not None
    return out.detach(), leaf.grad


def by_definition(op: str, values: Tensor, neighbors: Tensor) -> np.ndarray:
    """out_i = max or sum over j ∈ N(i) of values_j, one node at a time, in float64."""
    source = values.double().numpy()
    out = np.empty_like(source)
    for p, i in np.ndindex(*source.shape[:2]):
        rows = source[p, neighbors[p, i].numpy()]
        out[p, i] = rows.max(axis=0) if op == "gather_max" else rows.sum(axis=0)
    return out


@dtypes
@shapes
def test_gather_max_is_exact_on_both_paths(shape: tuple[int, int, int, int], dtype: torch.dtype) -> None:
    values, neighbors = case(shape, dtype)
    expected = by_definition("gather_max", values, neighbors)
    native = ops.gather_max(values, neighbors)
    with ops.plain_torch():
        plain = ops.gather_max(values, neighbors)
    assert native.dtype == plain.dtype == dtype
    assert np.array_equal(native.double().numpy(), expected)
    assert torch.equal(native, plain)


@dtypes
@shapes
def test_gather_sum_is_exact_on_both_paths(shape: tuple[int, int, int, int], dtype: torch.dtype) -> None:
    _, neighbors = case(shape, dtype)
    values = whole_numbers(shape[:3], dtype, limit=20)
    expected = by_definition("gather_sum", values, neighbors)
    native = ops.gather_sum(values, neighbors)
    with ops.plain_torch():
        plain = ops.gather_sum(values, neighbors)
    assert native.dtype == plain.dtype == dtype
    assert np.array_equal(native.double().numpy(), expected)
    assert torch.equal(native, plain)


@dtypes
@shapes
@pytest.mark.parametrize("op", [ops.gather_max, ops.gather_sum])
def test_gradients_are_exactly_those_of_plain_torch(
    op: Callable[[Tensor, Tensor], Tensor], shape: tuple[int, int, int, int], dtype: torch.dtype
) -> None:
    values, neighbors = case(shape, dtype)
    if dtype == torch.bfloat16:
        # Two different neighbours with the same bfloat16 value would leave the winner open.
        ranks = torch.argsort(values.float(), dim=1).argsort(dim=1)
        values = (ranks - 32).to(dtype)
    grad_out = whole_numbers(shape[:3], dtype, limit=1)
    _, native = with_gradient(op, values, neighbors, grad_out)
    with ops.plain_torch():
        _, plain = with_gradient(op, values, neighbors, grad_out)
    assert torch.equal(native, plain)
    # Every output's gradient arrives: once for the maximum, once a neighbour for the sum.
    arrivals = 1 if op is ops.gather_max else neighbors.shape[-1]
    assert native.double().sum() == arrivals * grad_out.double().sum()


def test_gradient_of_a_tie_goes_to_the_first_neighbor() -> None:
    values = torch.tensor([[[3.0], [3.0], [1.0]]])
    neighbors = torch.tensor([[[2, 1, 0], [0, 1, 2], [2, 2, 2]]], dtype=torch.int32)
    _, grad = with_gradient(ops.gather_max, values, neighbors, torch.tensor([[[1.0], [10.0], [100.0]]]))
    assert grad.flatten().tolist() == [10.0, 1.0, 100.0]


@pytest.mark.parametrize("op", [ops.gather_max, ops.gather_sum])
def test_gradcheck_of_the_plain_path(op: Callable[[Tensor, Tensor], Tensor]) -> None:
    values = random_values(2, 6, 3).double().requires_grad_()
    neighbors = random_neighbors(2, 6, 4)
    assert torch.autograd.gradcheck(lambda x: op(x, neighbors), (values,))


def test_other_dtypes_and_the_switch_take_the_plain_path(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("native kernel called")

    values, neighbors = case((2, 5, 3, 2), torch.float32)
    expected = ops.gather_max(values, neighbors)
    monkeypatch.setattr(ops._geom, "gather_max", refuse)
    assert torch.equal(ops.gather_max(values.double(), neighbors), expected.double())
    with ops.plain_torch():
        with ops.plain_torch():
            pass
        assert torch.equal(ops.gather_max(values, neighbors), expected)
    with pytest.raises(AssertionError, match="native kernel called"):
        ops.gather_max(values, neighbors)


def test_memory_layout_does_not_matter() -> None:
    values, neighbors = case((3, 12, 20, 4), torch.float32)
    strided_values = values.transpose(0, 2).contiguous().transpose(0, 2)
    strided_neighbors = neighbors.transpose(1, 2).contiguous().transpose(1, 2)
    assert not strided_values.is_contiguous()
    assert not strided_neighbors.is_contiguous()
    grad_out = whole_numbers((3, 12, 20), torch.float32, 3).transpose(0, 2).contiguous().transpose(0, 2)
    for op in (ops.gather_max, ops.gather_sum):
        expected = with_gradient(op, values, neighbors, grad_out.contiguous())
        found = with_gradient(op, strided_values, strided_neighbors, grad_out)
        assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))
    assert torch.equal(ops.knn(strided_values, 5), ops.knn(values, 5))
    assert torch.equal(
        ops.edge_max_leaky(strided_values, torch.ones(10), strided_neighbors, 0.2),
        ops.edge_max_leaky(values, torch.ones(10), neighbors, 0.2),
    )


@shapes
@pytest.mark.parametrize("slope", [0.0, 0.2, 1.0])
@dtypes
def test_edge_max_leaky_is_the_formula_in_one_pass(
    shape: tuple[int, int, int, int], slope: float, dtype: torch.dtype
) -> None:
    b, neighbors = case(shape, dtype)
    a, scale = random_values(*shape[:3], seed=3).to(dtype), random_values(shape[2], seed=4)
    parts = torch.cat([a, b], dim=-1)
    largest = torch.from_numpy(by_definition("gather_max", b, neighbors)).float()
    expected = leaky_relu(a.float() + scale * largest, slope).to(dtype)
    with ops.plain_torch():
        assert torch.equal(ops.edge_max_leaky(parts, scale, neighbors, slope), expected)
    assert torch.equal(ops.edge_max_leaky(parts, scale, neighbors, slope), expected)


@dtypes
@shapes
def test_pooling_is_exact_on_both_paths(shape: tuple[int, int, int, int], dtype: torch.dtype) -> None:
    n_patches, n_nodes, n_channels, _ = shape
    values = whole_numbers(shape[:3], dtype, limit=9)
    source = values.double().numpy()
    mean = torch.from_numpy(source.sum(axis=1)).float() / n_nodes
    expected = torch.cat([mean.to(dtype), torch.from_numpy(source.max(axis=1)).to(dtype)], dim=-1)
    native = ops.pool_nodes(values)
    with ops.plain_torch():
        plain = ops.pool_nodes(values)
    assert native.shape == (n_patches, 2 * n_channels)
    assert native.dtype == plain.dtype == dtype
    assert torch.equal(native, expected)
    assert torch.allclose(plain.float(), native.float(), rtol=1e-2 if dtype == torch.bfloat16 else 1e-6)


@dtypes
@shapes
def test_gradient_of_pooling_is_that_of_plain_torch(
    shape: tuple[int, int, int, int], dtype: torch.dtype
) -> None:
    n_patches, n_nodes, n_channels, _ = shape
    # Different values in every column: no ties.
    values = (random_values(*shape[:3]).argsort(dim=1).argsort(dim=1) - n_nodes // 2).to(dtype)
    grad_out = whole_numbers((n_patches, 2 * n_channels), dtype, limit=3)

    def gradient() -> Tensor:
        leaf = values.clone().requires_grad_()
        ops.pool_nodes(leaf).backward(grad_out)
        assert leaf.grad is not None
        return leaf.grad

    native = gradient()
    with ops.plain_torch():
        plain = gradient()
    assert torch.allclose(native.float(), plain.float(), rtol=1e-2 if dtype == torch.bfloat16 else 1e-6)
    # What arrives is what was sent: mean and maximum pass all of their gradient on.
    sent = grad_out.float().view(n_patches, 2, n_channels).sum(1)
    assert torch.allclose(native.float().sum(1), sent, atol=0.1 if dtype == torch.bfloat16 else 1e-4)


def test_pooling_takes_the_first_of_equal_nodes() -> None:
    leaf = torch.tensor([[[1.0], [2.0], [2.0]]], requires_grad=True)
    ops.pool_nodes(leaf).backward(torch.tensor([[0.0, 1.0]]))
    assert leaf.grad is not None
    assert leaf.grad.flatten().tolist() == [0.0, 1.0, 0.0]


# --- nearest neighbours --------------------------------------------------------------------------------


def squared_distances(features: Tensor) -> np.ndarray:
    x = features.double().numpy()
    return np.square(x[:, :, None] - x[:, None]).sum(-1)


def check_neighbor_sets(features: Tensor, found: Tensor, k: int, tolerance: float) -> None:
    """Each node's k distances are the k smallest there are, ascending, of k different nodes."""
    distances = squared_distances(features)
    chosen = np.take_along_axis(distances, found.numpy().astype(np.int64), axis=2)
    smallest = np.sort(distances, axis=2)[:, :, :k]
    assert found.shape == (*features.shape[:2], k)
    assert np.abs(chosen - smallest).max() <= tolerance
    assert (np.diff(np.sort(found.numpy(), axis=2), axis=2) > 0).all()


@pytest.mark.parametrize("k", [1, 2, 8, 12, 20, 33, 40])
@dtypes
def test_knn_finds_the_smallest_distances_on_both_paths(k: int, dtype: torch.dtype) -> None:
    features = random_values(3, 40, 19, seed=7).to(dtype)
    native = ops.knn(features, k)
    with ops.plain_torch():
        plain = ops.knn(features, k)
    assert native.dtype == plain.dtype == torch.int32
    for found in (native, plain):
        check_neighbor_sets(features, found, k, tolerance=1e-4)
    assert torch.equal(native[..., 0], torch.arange(40, dtype=torch.int32).expand(3, -1))


@pytest.mark.parametrize("k", [3, 8, 21, 40])
def test_knn_breaks_ties_by_the_lower_id(k: int) -> None:
    features = whole_numbers((2, 48, 3), torch.float32, limit=1)  # at most 27 places for 48 nodes
    distances = squared_distances(features)
    expected = np.empty((2, 48, k), dtype=np.int32)
    for p, i in np.ndindex(2, 48):
        expected[p, i] = sorted(range(48), key=lambda j: (j != i, distances[p, i, j], j))[:k]
    assert np.array_equal(ops.knn(features, k).numpy(), expected)
    assert np.array_equal(ops.knn(features.bfloat16(), k).numpy(), expected)
    with ops.plain_torch():
        check_neighbor_sets(features, ops.knn(features, k), k, tolerance=0.0)


def test_plain_knn_keeps_its_precision_under_autocast() -> None:
    features = random_values(2, 40, 19, seed=7) + 3.0
    with ops.plain_torch(), torch.autocast("cpu", dtype=torch.bfloat16):
        found = ops.knn(features, 8)
    check_neighbor_sets(features, found, 8, tolerance=1e-3)


def test_knn_has_no_gradient_and_leaves_the_features() -> None:
    features = random_values(1, 9, 4).requires_grad_()
    before = features.detach().clone()
    assert not ops.knn(features, 3).requires_grad
    assert torch.equal(features, before)


# --- guards --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [-1, 5])
@pytest.mark.parametrize("op", [ops.gather_max, ops.gather_sum])
def test_a_neighbor_outside_the_patch_is_named(op: Callable[[Tensor, Tensor], Tensor], bad: int) -> None:
    values, neighbors = case((2, 5, 3, 2), torch.float32)
    neighbors[1, 3, 1] = bad
    with pytest.raises(ConfigError, match=rf"{bad} at \[1, 3, 1\]"):
        op(values, neighbors)
    with pytest.raises(ConfigError, match=rf"{bad} at \[1, 3, 1\]"):
        ops.edge_max_leaky(torch.cat([values, values], -1), torch.ones(3), neighbors, 0.2)


@pytest.mark.parametrize("k", [0, 6])
def test_knn_refuses_more_neighbors_than_nodes(k: int) -> None:
    with pytest.raises(ConfigError, match=f"is {k}"):
        ops.knn(random_values(1, 5, 3), k)


@pytest.mark.parametrize("slope", [-0.1, 1.5, float("nan")])
def test_edge_max_leaky_refuses_a_slope_that_decreases(slope: float) -> None:
    values, neighbors = case((2, 5, 3, 2), torch.float32)
    with pytest.raises(ConfigError, match="slope"):
        ops.edge_max_leaky(torch.cat([values, values], -1), torch.ones(3), neighbors, slope)


def test_patch_counts_must_agree() -> None:
    values, neighbors = case((2, 5, 3, 2), torch.float32)
    with pytest.raises(ConfigError, match="neighbors"):
        ops.gather_max(values, neighbors[:1])
