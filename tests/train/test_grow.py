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


def test_a_wider_head_answers_the_same_and_learns_with_all_of_it() -> None:
    first, last = STAGE.network.head_channels
    wanted = replace(STAGE, network=replace(STAGE.network, head_channels=(first, 3 * last)))
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
    assert (wide.out.weight.grad[:, last:].abs().sum(dim=0) > 0).any()
    # Drawn, and every time the same.
    again = grown(narrow.state_dict(), STAGE, wanted)
    assert all(torch.equal(again[name], weights[name]) for name in weights)


def test_a_narrower_head_is_refused() -> None:
    first, last = STAGE.network.head_channels
    wanted = replace(STAGE, network=replace(STAGE.network, head_channels=(first, last - 1)))
    with pytest.raises(ConfigError, match="another layout"):
        grown(build_network(STAGE.network).state_dict(), STAGE, wanted)


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
