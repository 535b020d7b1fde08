"""Networks: the paper's layers to the channel, what an untrained one answers, gradients, and learning."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from nn_cases import SMALL_CENTRE, SMALL_NODES, random_patches
from torch import nn

from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.errors import ConfigError
from gcnd.nn.cascade import PatchConfig
from gcnd.nn.layers import DynamicEdgeConv, EdgeConv
from gcnd.nn.networks import (
    PAPER_FIRST,
    PAPER_NEXT,
    CentreNormalNet,
    DenseNorm,
    NetworkConfig,
    NodeNormalNet,
    build_network,
)
from gcnd.predict import PatchArrays, make_extractor
from gcnd.train.losses import chord_loss
from gcnd.train.samples import Batch

configs = pytest.mark.parametrize("config", [SMALL_NODES, SMALL_CENTRE], ids=["nodes", "centre"])


def edge_widths(layers: nn.ModuleList) -> list[tuple[int, int]]:
    widths = []
    for layer in layers:
        assert isinstance(layer, EdgeConv)
        shapes = {layer.center.weight.shape, layer.neighbor.weight.shape}
        assert shapes == {torch.Size((layer.norm.num_features, layer.center.in_features))}
        widths.append((layer.center.in_features, layer.center.out_features))
    return widths


def dense_widths(layers: nn.Sequential) -> list[tuple[int, int]]:
    assert all(isinstance(layer, DenseNorm) for layer in layers)
    return [(layer.linear.in_features, layer.linear.out_features) for layer in layers]


@pytest.mark.parametrize(
    ("config", "static", "dynamic", "pool", "head", "n_parameters"),
    [
        # (64, 128, 128, 256, 256, 256, 1024, 512, 256, 64), Sec. 7.6
        (
            PAPER_FIRST,
            [(8, 64), (64, 128), (128, 128)],
            [(128, 256), (256, 256), (256, 256)],
            (1088, 1024),
            [(2048, 512), (512, 256), (256, 64)],
            2_694_083,
        ),
        # (64, 128, 256, 256, 512, 256, 64), Sec. 7.6
        (
            PAPER_NEXT,
            [(8, 64), (64, 128)],
            [(128, 256), (256, 256)],
            (704, 512),
            [(1024, 256), (256, 64)],
            856_259,
        ),
    ],
    ids=["first", "next"],
)
def test_the_papers_layers(
    config: NetworkConfig,
    static: list[tuple[int, int]],
    dynamic: list[tuple[int, int]],
    pool: tuple[int, int],
    head: list[tuple[int, int]],
    n_parameters: int,
) -> None:
    network = build_network(config)
    assert isinstance(network, CentreNormalNet)
    assert edge_widths(network.trunk.static) == static
    assert edge_widths(network.trunk.dynamic) == dynamic
    assert not any(isinstance(layer, DynamicEdgeConv) for layer in network.trunk.static)
    assert [layer.knn_k for layer in network.trunk.dynamic] == [8] * len(dynamic)
    assert {layer.order for layer in (*network.trunk.static, *network.trunk.dynamic)} == {"edge"}
    assert (network.pool.linear.in_features, network.pool.linear.out_features) == pool
    assert dense_widths(network.head) == head
    assert (network.out.in_features, network.out.out_features, network.out.bias is not None) == (64, 3, True)
    # Weights of every layer, scale and shift of its BatchNorm, and the last layer's bias.
    by_hand = sum(2 * a * b + 2 * b for a, b in static + dynamic)
    by_hand += sum(a * b + 2 * b for a, b in [pool, *head]) + 64 * 3 + 3
    assert sum(parameter.numel() for parameter in network.parameters()) == by_hand == n_parameters


def test_node_network_layers() -> None:
    network = build_network(SMALL_NODES)
    assert isinstance(network, NodeNormalNet)
    assert edge_widths(network.trunk.static) == [(17, 12), (12, 16)]
    assert edge_widths(network.trunk.dynamic) == [(16, 16), (16, 20)]
    assert (network.pool.linear.in_features, network.pool.linear.out_features) == (64, 24)
    assert network.head_node.weight.shape == (20, 64)
    assert network.head_patch.weight.shape == (20, 48)
    assert dense_widths(network.head) == [(20, 12)]
    assert network.out.weight.shape == (3, 12)


@configs
def test_forward_is_the_formula(config: NetworkConfig) -> None:
    torch.manual_seed(1)
    network = build_network(config).eval()
    nn.init.normal_(network.out.weight, std=0.3)
    features, neighbors = random_patches(config)
    x, outputs = features, []
    for layer in (*network.trunk.static, *network.trunk.dynamic):
        x = layer(x) if isinstance(layer, DynamicEdgeConv) else layer(x, neighbors)
        outputs.append(x)
    x = torch.cat(outputs, dim=-1)
    y = network.pool(x)
    pooled = torch.cat([y.mean(dim=1), y.max(dim=1).values], dim=-1)
    if isinstance(network, CentreNormalNet):
        expected = network.out(network.head(pooled))
        assert expected.shape == (4, 3)
    else:
        # One linear layer on [x_i, pooled], which the network splits in two.
        weight = torch.cat([network.head_node.weight, network.head_patch.weight], dim=1)
        joined = torch.cat([x, pooled[:, None].expand(-1, x.shape[1], -1)], dim=-1)
        h = nn.functional.leaky_relu(network.head_norm(joined @ weight.T), config.slope)
        expected = features[..., 3:6] + network.out(network.head(h))
        assert expected.shape == (4, 32, 3)
    assert (network(features, neighbors) - expected).abs().max() < 2e-5


def test_an_untrained_node_network_returns_the_input_normals() -> None:
    network = build_network(SMALL_NODES)
    features, neighbors = random_patches(SMALL_NODES)
    for mode in (True, False):
        assert torch.equal(network.train(mode)(features, neighbors), features[..., 3:6])


@configs
def test_every_parameter_gets_a_gradient(config: NetworkConfig) -> None:
    torch.manual_seed(2)
    network = build_network(config).train()
    nn.init.normal_(network.out.weight, std=0.3)  # it starts at zero, where nothing behind it learns
    network(*random_patches(config)).square().sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        # Every single output channel of every layer takes part.
        rows = parameter.grad.reshape(len(parameter), -1).abs().amax(dim=1)
        assert torch.isfinite(rows).all(), name
        assert (rows > 0).float().mean() > 0.8, name


@configs
def test_patches_do_not_mix_in_evaluation_mode(config: NetworkConfig) -> None:
    network = build_network(config).eval()
    nn.init.normal_(network.out.weight, std=0.3)
    features, neighbors = random_patches(config)
    together = network(features, neighbors)
    for patch in range(len(features)):
        alone = network(features[patch : patch + 1], neighbors[patch : patch + 1])
        assert (alone[0] - together[patch]).abs().max() < 1e-5


@pytest.mark.parametrize(
    ("changes", "n_nodes"),
    [
        ({"dynamic_channels": ()}, 64),
        ({"static_channels": ()}, 64),
        ({"knn_k": 1}, 64),
        ({"knn_k": 4}, 64),
        ({"knn_k": 16}, 16),
        ({}, 16),
        ({}, 512),
        ({"in_channels": 8}, 64),
        ({"norm_order": "edge", "architecture": "nodes"}, 64),
        ({"norm_order": "node", "architecture": "centre"}, 64),
        ({"head_channels": (9,)}, 64),
    ],
    ids=str,
)
@configs
def test_ablations_build_and_depend_on_their_layers(
    config: NetworkConfig, changes: dict[str, object], n_nodes: int
) -> None:
    config = replace(config, **changes)  # type: ignore[arg-type]
    torch.manual_seed(0)
    network = build_network(config).eval()
    nn.init.normal_(network.out.weight, std=0.3)
    assert len(network.trunk.static) == len(config.static_channels)
    assert [layer.knn_k for layer in network.trunk.dynamic] == [config.knn_k] * len(config.dynamic_channels)
    features, neighbors = random_patches(config, n_patches=2, n_nodes=n_nodes)
    out = network(features, neighbors)
    assert out.shape == ((2, n_nodes, 3) if config.architecture == "nodes" else (2, 3))
    # Static layers, and only they, read the neighbours.
    itself = torch.arange(n_nodes, dtype=torch.int32)[None, :, None].expand_as(neighbors).contiguous()
    assert torch.equal(network(features, itself), out) == (not config.static_channels)
    assert not torch.equal(network(features.flip(1), neighbors), out)


@pytest.mark.parametrize(
    "config",
    [PAPER_FIRST, PAPER_NEXT, SMALL_NODES, replace(SMALL_NODES, dynamic_channels=(), slope=0.1)],
    ids=["first", "next", "small", "static"],
)
def test_config_survives_json(config: NetworkConfig) -> None:
    assert NetworkConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"in_channels": 9}, "in_channels is 9, allowed: 8, 12, 17, 21, 26, 30, 35 or 39"),
        ({"static_channels": (), "dynamic_channels": ()}, "at least one static or dynamic layer"),
        ({"head_channels": ()}, "head_channels is empty"),
        ({"architecture": "node"}, "architecture is 'node', allowed"),
        ({"norm_order": "edges"}, "norm_order is 'edges', allowed"),
    ],
)
def test_config_guards(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(SMALL_NODES, **changes)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=message):
        NetworkConfig.from_dict({**SMALL_NODES.to_dict(), **changes})


def test_an_unknown_field_is_named() -> None:
    with pytest.raises(ConfigError, match="dropout"):
        NetworkConfig.from_dict({**SMALL_NODES.to_dict(), "dropout": 0.5})


@pytest.mark.parametrize("field", sorted(SMALL_NODES.to_dict()))
def test_a_missing_field_is_named(field: str) -> None:
    values = SMALL_NODES.to_dict()
    del values[field]
    with pytest.raises(ConfigError, match=field):
        NetworkConfig.from_dict(values)


def test_more_neighbors_than_nodes_are_refused() -> None:
    network = build_network(replace(SMALL_NODES, knn_k=33))
    with pytest.raises(ConfigError, match="is 33"):
        network(*random_patches(SMALL_NODES, n_nodes=32))


def sixteen_patches() -> Batch:
    """Patches over a noisy corner of three squares, with the clean normals."""
    side = np.linspace(0, 1, 9)
    u, v = (x.ravel() for x in np.meshgrid(side, side, indexing="ij"))
    w = np.zeros_like(u)
    corners = [np.stack(axes, axis=1) for axes in ((u, v, w), (w, u, v), (v, w, u))]
    squares = np.array([[i, i + 9, i + 10, i + 1] for i in range(72) if i % 9 != 8])
    one_sheet = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    clean = np.concatenate(corners)
    representatives, welded = _geom.weld(clean)
    clean = clean[representatives]
    faces = np.ascontiguousarray(welded[np.concatenate([one_sheet + 81 * k for k in range(3)])])
    noisy = add_noise(clean, faces, level=0.3, seed=1)
    extractor = make_extractor(_geom.Topology(faces, len(clean)), noisy, PatchConfig(), seed=0)
    patches = PatchArrays(16, PatchConfig())
    patches.fill(extractor, np.linspace(0, len(faces) - 1, 16).astype(np.uint32))
    normals = _geom.face_geometry(clean, faces)[0][patches.face_ids]
    target = np.einsum("pnr,prc->pnc", normals, patches.world_from_patch)
    return Batch(
        torch.from_numpy(patches.features),
        torch.from_numpy(patches.neighbors),
        torch.from_numpy(target.astype(np.float32)),
        torch.from_numpy(patches.mask.astype(np.float32)),
    )


@configs
def test_sixteen_patches_are_learnt_by_heart(config: NetworkConfig) -> None:
    batch = sixteen_patches()
    torch.manual_seed(0)
    network = build_network(replace(config, in_channels=17, dynamic_channels=(24, 32))).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.02)
    losses = []
    for step in range(120):
        for group in optimizer.param_groups:
            group["lr"] = 0.02 * (1 - step / 120)
        loss = chord_loss(network(batch.features, batch.neighbors), batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[0] > 0.2
    assert losses[-1] < 0.03
