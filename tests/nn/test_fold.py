"""Folded inference against evaluation mode, after training, with BatchNorm scales of both signs."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from nn_cases import SMALL_CENTRE, SMALL_NODES, random_patches
from torch import Tensor, nn

from gcnd.nn import ops
from gcnd.nn.fold import folded, for_inference
from gcnd.nn.networks import CentreNormalNet, NetworkConfig, NodeNormalNet, build_network

CASES = [
    (replace(config, norm_order=order), negative)
    for config in (SMALL_CENTRE, SMALL_NODES)
    for order in ("edge", "node")
    for negative in (False, True)
]

cases = pytest.mark.parametrize(
    ("config", "negative"),
    CASES,
    ids=[f"{c.architecture}-{c.norm_order}-{'negative' if n else 'positive'}" for c, n in CASES],
)


def trained(config: NetworkConfig, negative: bool) -> CentreNormalNet | NodeNormalNet:
    """A network after four steps on random patches; with `negative`, every third scale has changed its sign."""
    torch.manual_seed(6)
    network = build_network(config).train()
    nn.init.normal_(network.out.weight, std=0.3)
    optimizer = torch.optim.AdamW(network.parameters(), lr=1e-2)
    features, neighbors = random_patches(config)
    for step in range(4):
        if step == 2 and negative:
            flip_scales(network)
        loss = (network(features * (1 + 0.1 * step), neighbors) - 0.3).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return network.eval()


@torch.no_grad()
def flip_scales(network: nn.Module) -> None:
    for norm in network.modules():
        if isinstance(norm, nn.BatchNorm1d):
            norm.weight[::3] *= -1


def answers(network: nn.Module, config: NetworkConfig) -> Tensor:
    with torch.inference_mode():
        out: Tensor = network(*random_patches(config, n_patches=6))
    return out


@cases
def test_folded_equals_evaluation_mode(config: NetworkConfig, negative: bool) -> None:
    network = trained(config, negative)
    twin = folded(network)
    expected = answers(network, config)
    # What is compared depends on the patch, not on a constant.
    assert expected.std() > 0.05
    assert (answers(twin, config) - expected).abs().max() < 1e-4
    with ops.plain_torch():
        assert (answers(twin, config) - expected).abs().max() < 1e-4
    assert not any(isinstance(module, nn.BatchNorm1d) for module in twin.modules())
    assert not any(parameter.requires_grad for parameter in twin.parameters())
    assert not twin.training


@cases
def test_the_original_is_left_as_it_was(config: NetworkConfig, negative: bool) -> None:
    network = trained(config, negative).train()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    twin = folded(network)
    assert network.training
    assert all(parameter.requires_grad for parameter in network.parameters())
    with torch.no_grad():
        for parameter in twin.parameters():
            parameter.add_(1.0)
    after = network.state_dict()
    assert after.keys() == before.keys()
    assert all(torch.equal(after[name], tensor) for name, tensor in before.items())


@cases
def test_bfloat16_answers_nearly_the_same(config: NetworkConfig, negative: bool) -> None:
    network = trained(config, negative)
    twin = for_inference(network, "bfloat16")
    assert {m.weight.dtype for m in twin.modules() if isinstance(m, nn.Linear)} == {torch.bfloat16}
    layers = list(twin.trunk.layers)  # type: ignore[union-attr, arg-type]
    assert {layer.scale.dtype for layer in layers} == {torch.float32}
    assert all((layer.scale == 1).all() for layer in layers) == (config.norm_order == "edge")
    assert [layer.knn_k for layer in layers] == [None, None, config.knn_k, config.knn_k]
    expected, found = answers(network, config), answers(twin, config)
    assert found.dtype == torch.float32
    # Neighbours in feature space may change with rounding: the mean, not the maximum.
    assert 0 < (found - expected).abs().mean() < 0.02 * expected.std() + 0.01
    assert torch.equal(answers(for_inference(folded(network), "bfloat16"), config), found)


def test_float32_is_the_folded_network_itself() -> None:
    twin = folded(trained(SMALL_NODES, True))
    assert for_inference(twin, "float32") is twin
    other = nn.Linear(2, 2)
    assert for_inference(other, "float32") is other


def test_running_statistics_are_used_whatever_the_mode() -> None:
    network = trained(SMALL_NODES, negative=True)
    expected = answers(folded(network), SMALL_NODES)
    assert torch.equal(answers(folded(network.train()), SMALL_NODES), expected)
