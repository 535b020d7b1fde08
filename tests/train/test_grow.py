"""Weights that start a larger network: it answers the same, whatever is new."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from train_cases import STAGE

from gcnd.errors import ConfigError
from gcnd.nn.cascade import PatchConfig, StageConfig
from gcnd.nn.networks import build_network
from gcnd.train.grow import grown


@pytest.mark.parametrize(
    "channels",
    [
        {"scale_space": True},
        {"roughness": True},
        {"scale_space": True, "roughness": True},
        {"first_normals": True},
        {"scale_space": True, "n_nodes": 48, "patch_scale": 5.5},
    ],
)
def test_weights_grown_for_new_channels_answer_the_same(channels: dict[str, Any]) -> None:
    patch = replace(STAGE.patch, **channels)
    wider = replace(STAGE, network=replace(STAGE.network, in_channels=patch.n_channels), patch=patch)
    torch.manual_seed(5)
    narrow = build_network(STAGE.network)
    torch.nn.init.normal_(narrow.out.weight)
    wide = build_network(wider.network)
    wide.load_state_dict(grown(narrow.state_dict(), STAGE, wider))
    features = torch.randn(3, 32, patch.n_channels)
    neighbors = torch.randint(0, 32, (3, 32, 3), dtype=torch.int32)
    expected = narrow.eval()(features[..., :17], neighbors)
    assert torch.allclose(wide.eval()(features, neighbors), expected, atol=1e-5)


def test_weights_are_grown_between_the_channels_that_there_are() -> None:
    given, wanted = (
        replace(STAGE, network=replace(STAGE.network, in_channels=patch.n_channels), patch=patch)
        for patch in (
            replace(STAGE.patch, roughness=True),
            replace(STAGE.patch, scale_space=True, first_normals=True, roughness=True),
        )
    )
    torch.manual_seed(5)
    narrow, wide = build_network(given.network), build_network(wanted.network)
    torch.nn.init.normal_(narrow.out.weight)
    wide.load_state_dict(grown(narrow.state_dict(), given, wanted))
    features = torch.randn(3, 32, wanted.patch.n_channels)
    neighbors = torch.randint(0, 32, (3, 32, 3), dtype=torch.int32)
    old = torch.cat([features[..., :17], features[..., -4:]], dim=-1)
    answered = wide.eval()(features, neighbors)
    assert torch.allclose(answered, narrow.eval()(old, neighbors), atol=1e-5)
    changed = features.clone()
    changed[..., 17:35] += 1
    assert torch.equal(wide.eval()(changed, neighbors), answered)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        (
            replace(
                STAGE,
                network=replace(STAGE.network, in_channels=26),
                patch=replace(STAGE.patch, scale_space=True),
            ),
            STAGE,
        ),
        (STAGE, replace(STAGE, network=replace(STAGE.network, knn_k=5))),
        (STAGE, replace(STAGE, patch=replace(STAGE.patch, sigma_vote=0.5))),
        (STAGE, replace(STAGE, patch=replace(STAGE.patch, vertex_offsets=False, scale_space=True))),
    ],
    ids=["fewer channels", "other network", "other patches", "other channels"],
)
def test_weights_of_another_layout_are_refused(given: StageConfig, wanted: StageConfig) -> None:
    with pytest.raises(ConfigError, match="another layout"):
        grown(build_network(given.network).state_dict(), given, wanted)


WIDER: list[dict[str, Any]] = [
    {"head_channels": (12, 24)},
    {"head_channels": (20, 8)},
    {"pool_channels": 24},
    {"dynamic_channels": (8, 20)},
    {"dynamic_channels": (8, 20), "pool_channels": 24, "head_channels": (20, 24)},
]
"""What may be wider than in `STAGE`, whose layers are (8, 12), 16 and (12, 8)."""


@pytest.mark.parametrize("wider", WIDER, ids=str)
def test_wider_layers_answer_the_same_and_learn_with_all_of_them(wider: dict[str, Any]) -> None:
    wanted = replace(STAGE, network=replace(STAGE.network, **wider))
    torch.manual_seed(5)
    narrow = build_network(STAGE.network)
    torch.nn.init.normal_(narrow.out.weight)
    wide = build_network(wanted.network)
    weights = grown(narrow.state_dict(), STAGE, wanted)
    wide.load_state_dict(weights)
    features = torch.randn(3, 32, STAGE.patch.n_channels)
    neighbors = torch.randint(0, 32, (3, 32, 3), dtype=torch.int32)
    answered = wide.eval()(features, neighbors)
    assert torch.allclose(answered, narrow.eval()(features, neighbors), atol=1e-5)
    answered.square().sum().backward()
    for (name, grown_one), old in zip(wide.named_parameters(), narrow.parameters(), strict=True):
        if grown_one.dim() == 2 and grown_one.shape[1] > old.shape[1]:
            # What the old nodes have for new ones is zero, and is where these come in.
            assert (grown_one[: len(old)] == 0).any(dim=0).sum() >= grown_one.shape[1] - old.shape[1], name
            assert grown_one.grad is not None
            assert grown_one.grad[: len(old)][grown_one[: len(old)] == 0].abs().sum() > 0, name
    # Drawn, and every time the same.
    again = grown(narrow.state_dict(), STAGE, wanted)
    assert all(torch.equal(again[name], weights[name]) for name in weights)


@pytest.mark.parametrize(
    "other",
    [
        {"head_channels": (12, 7)},
        {"head_channels": (12, 8, 8)},
        {"pool_channels": 15},
        {"dynamic_channels": (8, 11)},
        {"dynamic_channels": (9, 12)},
        {"static_channels": (9,)},
    ],
    ids=str,
)
def test_layers_that_may_not_be_of_another_width_are_refused(other: dict[str, Any]) -> None:
    wanted = replace(STAGE, network=replace(STAGE.network, **other))
    with pytest.raises(ConfigError, match="another layout"):
        grown(build_network(STAGE.network).state_dict(), STAGE, wanted)


def test_a_network_for_the_centre_grows_no_wider() -> None:
    given = replace(STAGE, network=replace(STAGE.network, architecture="centre"), coverage=None)
    wanted = replace(given, network=replace(given.network, pool_channels=24))
    with pytest.raises(ConfigError, match="another layout"):
        grown(build_network(given.network).state_dict(), given, wanted)


@pytest.mark.parametrize("patch", [replace(STAGE.patch, roughness=True), STAGE.patch], ids=["more", "same"])
def test_behind_a_spatial_transformer_nothing_grows(patch: PatchConfig) -> None:
    given, wanted = (
        replace(
            STAGE,
            network=replace(STAGE.network, architecture="transformed-nodes", in_channels=of.n_channels),
            patch=of,
        )
        for of in (STAGE.patch, patch)
    )
    weights = build_network(given.network).state_dict()
    if patch == STAGE.patch:
        assert grown(weights, given, wanted).keys() == weights.keys()
        return
    with pytest.raises(ConfigError, match="another layout"):
        grown(weights, given, wanted)
