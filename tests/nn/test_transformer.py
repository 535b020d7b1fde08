"""The spatial transformer in front of a network."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from nn_cases import SMALL_CENTRE, SMALL_NODES, random_patches
from torch import nn

from gcnd.nn.cascade import Cascade, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.fold import for_inference
from gcnd.nn.networks import NetworkConfig, build_network
from gcnd.nn.transformer import SpatialTransformer, TransformedNet, vector_starts
from gcnd.weights import load_cascade, save_cascade

CONFIGS = [
    replace(SMALL_CENTRE, architecture="transformed-centre"),
    replace(SMALL_NODES, architecture="transformed-nodes"),
]

both = pytest.mark.parametrize("config", CONFIGS, ids=lambda config: config.architecture)


def turned_by(network: TransformedNet, matrix: torch.Tensor) -> None:
    """Makes the transformer answer one matrix whatever the patch."""
    with torch.no_grad():
        network.transformer.out.bias.copy_((matrix - torch.eye(3)).flatten())


@pytest.mark.parametrize(
    ("n_channels", "starts"), [(8, (0, 3)), (17, (0, 3, 8, 11, 14)), (26, (0, 3, 8, 11, 14, 17, 20, 23))]
)
def test_where_vectors_start(n_channels: int, starts: tuple[int, ...]) -> None:
    assert vector_starts(n_channels) == starts


@both
def test_an_untrained_transformer_changes_nothing(config: NetworkConfig) -> None:
    torch.manual_seed(1)
    network = build_network(config).eval()
    assert isinstance(network, TransformedNet)
    features, neighbors = random_patches(config)
    assert torch.equal(network(features, neighbors), network.network(features, neighbors))


@both
def test_it_turns_vectors_and_leaves_area_and_degree(config: NetworkConfig) -> None:
    network = build_network(config)
    matrix = torch.tensor([[0.0, 2, 0], [0, 0, 3], [5, 0, 0]])
    turned_by(network, matrix)
    features, neighbors = random_patches(config)
    turned = network.transformer(features, neighbors)
    assert torch.equal(turned[..., 6:8], features[..., 6:8])
    for start in vector_starts(config.in_channels):
        vectors = features[..., start : start + 3]
        expected = torch.stack([5 * vectors[..., 2], 2 * vectors[..., 0], 3 * vectors[..., 1]], dim=-1)
        torch.testing.assert_close(turned[..., start : start + 3], expected)


def test_patches_are_turned_apart() -> None:
    torch.manual_seed(2)
    transformer = SpatialTransformer(8).eval()
    nn.init.normal_(transformer.out.weight, std=0.1)
    features, neighbors = random_patches(SMALL_CENTRE, n_patches=6)
    together = transformer(features, neighbors)
    torch.testing.assert_close(transformer(features[2:4], neighbors[2:4]), together[2:4])
    change = (together - features).abs().amax(dim=(1, 2))
    assert change.min() > 1e-3
    assert change.max() / change.min() > 1.05


@both
def test_inference_equals_evaluation_mode(config: NetworkConfig) -> None:
    torch.manual_seed(3)
    network = build_network(config)
    nn.init.normal_(network.transformer.out.weight, std=0.1)
    nn.init.normal_(network.network.out.weight, std=0.3)
    features, neighbors = random_patches(config)
    network.train()(features, neighbors)
    network.eval()
    with torch.inference_mode():
        expected = network(features, neighbors)
        got = for_inference(network, "float32")(features, neighbors)
    assert expected.std() > 0.05
    assert (got - expected).abs().max() < 1e-4


@both
def test_weights_from_a_file_predict_the_same(config: NetworkConfig, tmp_path: Path) -> None:
    torch.manual_seed(5)
    network = build_network(config).eval()
    nn.init.normal_(network.transformer.out.weight, std=0.1)
    nn.init.normal_(network.network.out.weight, std=0.3)
    stage = StageConfig(config, PatchConfig(vertex_offsets=config.in_channels > 8))
    cascade = Cascade.assembled([(stage, network)], RefinementConfig())
    save_cascade(tmp_path / "w.safetensors", cascade, {})
    loaded = load_cascade(str(tmp_path / "w.safetensors")).stages[0]
    features, neighbors = random_patches(config)
    with torch.inference_mode():
        expected = network(features, neighbors)
        assert (loaded(features, neighbors) - expected).abs().max() < 1e-4
    assert expected.std() > 0.05
    assert all(parameter.requires_grad for parameter in network.parameters())


@both
def test_every_parameter_gets_a_gradient(config: NetworkConfig) -> None:
    torch.manual_seed(4)
    network = build_network(config).train()
    # The last layers start at zero and would stop the gradient on its way.
    nn.init.normal_(network.transformer.out.weight, std=0.1)
    nn.init.normal_(network.network.out.weight, std=0.3)
    network(*random_patches(config)).square().mean().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name
