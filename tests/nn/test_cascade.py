"""Configurations of stages and cascades: round trips, guards, and the order of passes."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
import torch
from nn_cases import SMALL_CENTRE, SMALL_NODES, random_patches, signed_scales

from gcnd.errors import ConfigError
from gcnd.nn.cascade import (
    Cascade,
    CascadeConfig,
    PatchConfig,
    RefinementConfig,
    StageConfig,
    written_out,
)

PAPER_PATCH = PatchConfig(patch_scale=8.0, n_nodes=256, budget="random", vertex_offsets=False)

CONFIG = CascadeConfig(
    (
        StageConfig(SMALL_CENTRE, PAPER_PATCH),
        StageConfig(SMALL_NODES, PatchConfig(voting_region="two_ring", sigma_vote=0.4), 2, 0.2, 0.1),
    ),
    RefinementConfig(4, 0.15, 1.5),
    vertex_iterations=9,
    keep_detail=True,
    pull=0.01,
    flat_passes=1,
)


def test_config_survives_json() -> None:
    as_read = json.loads(json.dumps(CONFIG.to_dict()))
    assert CascadeConfig.from_dict(as_read) == CONFIG
    assert StageConfig.from_dict(json.loads(json.dumps(CONFIG.stages[1].to_dict()))) == CONFIG.stages[1]


@pytest.mark.parametrize(("offsets", "channels"), [(True, 17), (False, 8)])
def test_patch_channels(offsets: bool, channels: int) -> None:
    assert PatchConfig(vertex_offsets=offsets).n_channels == channels
    assert PatchConfig(vertex_offsets=offsets, scale_space=True).n_channels == channels + 9
    told = PatchConfig(vertex_offsets=offsets, scale_space=True, first_normals=True, roughness=True)
    assert told.n_channels == channels + 22


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"patch": PatchConfig(vertex_offsets=False)}, "takes 17 channels, its patches have 8"),
        ({"passes": 0}, "passes is 0"),
        ({"coverage": 0.0}, r"coverage is 0\.0"),
        ({"coverage": float("inf")}, "coverage is inf"),
        ({"coverage": float("nan")}, "coverage is nan"),
        ({"early_coverage": -1.0}, r"early_coverage is -1\.0"),
        ({"network": SMALL_CENTRE, "patch": PAPER_PATCH, "early_coverage": 0.5}, "needs coverage = None"),
        (
            {"network": SMALL_CENTRE, "patch": PAPER_PATCH, "coverage": 0.5},
            "needs coverage = None",
        ),
    ],
)
def test_stage_guards(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(StageConfig(SMALL_NODES), **changes)


@pytest.mark.parametrize("field", ["network", "patch", "passes", "coverage"])
def test_a_stage_without_a_field_is_refused(field: str) -> None:
    values = CONFIG.stages[0].to_dict()
    del values[field]
    with pytest.raises(ConfigError, match=field):
        StageConfig.from_dict(values)


def test_weights_from_before_keep_no_detail_and_fit_no_vertices() -> None:
    values = CONFIG.to_dict()
    del values["keep_detail"], values["pull"]
    assert CascadeConfig.from_dict(values) == replace(CONFIG, keep_detail=False, pull=None)
    for name, wrong, message in (
        ("keep_detail", 1, "keep_detail is 1, allowed: True or False"),
        ("pull", -0.1, "pull is -0.1, allowed: a number, 0 to 1000"),
        ("pull", True, "pull is True"),
        ("pull", "0.1", "pull is '0.1'"),
        ("pull", float("nan"), "pull is nan"),
    ):
        with pytest.raises(ConfigError, match=message):
            CascadeConfig.from_dict({**values, name: wrong})


def test_weights_from_before_have_one_coverage_and_no_passes_more() -> None:
    values = json.loads(json.dumps(CONFIG.to_dict()))
    del values["flat_passes"]
    for stage in values["stages"]:
        del stage["early_coverage"]
    stages = tuple(replace(stage, early_coverage=None) for stage in CONFIG.stages)
    assert CascadeConfig.from_dict(values) == replace(CONFIG, stages=stages, flat_passes=0)
    for wrong in (-1, 101, "2"):
        with pytest.raises(ConfigError, match="flat_passes is"):
            CascadeConfig.from_dict(values | {"flat_passes": wrong})


def test_early_passes_have_a_coverage_of_their_own() -> None:
    stage = replace(CONFIG.stages[1], passes=3)
    alike = replace(stage, early_coverage=None)
    coverages = [config.coverage for config, _ in written_out([(stage, None), (alike, None)])]
    assert coverages == [0.1, 0.1, 0.2, 0.2, 0.2, 0.2]


@pytest.mark.parametrize("field", ["stages", "refinement", "vertex_iterations"])
def test_a_cascade_without_a_field_is_refused(field: str) -> None:
    values = CONFIG.to_dict()
    del values[field]
    with pytest.raises(ConfigError, match=field):
        CascadeConfig.from_dict(values)


def test_unknown_and_misshapen_fields_are_refused() -> None:
    values = CONFIG.to_dict()
    with pytest.raises(ConfigError, match="colour"):
        CascadeConfig.from_dict({**values, "stages": [{**values["stages"][0], "patch": {"colour": 1}}]})
    with pytest.raises(ConfigError, match="cascade configuration does not fit"):
        CascadeConfig.from_dict({**values, "vertex_iterations": "many"})
    with pytest.raises(ConfigError, match="cascade configuration does not fit"):
        CascadeConfig.from_dict({**values, "stages": 3})
    with pytest.raises(ConfigError, match="strength"):
        CascadeConfig.from_dict({**values, "refinement": {"strength": 2}})


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"iterations": -1}, "iterations is -1"),
        ({"sigma_r": 0.0}, "sigma_r is 0.0"),
        ({"sigma_r": float("nan")}, "sigma_r is nan"),
        ({"tolerance": -0.5}, "tolerance is -0.5"),
        ({"largest_spread": 0.0}, "largest_spread is 0.0"),
        ({"flat_only": 1}, "flat_only is 1, allowed: True or False"),
    ],
)
def test_refinement_out_of_range_is_named(changed: dict[str, float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        RefinementConfig(**changed)  # type: ignore[arg-type]


def test_a_cascade_needs_a_stage() -> None:
    with pytest.raises(ConfigError, match="at least one stage"):
        Cascade(CascadeConfig(()))


def test_passes_write_out_what_runs_more_than_once() -> None:
    cascade = Cascade(CONFIG)
    first, second = cascade.stages
    assert [id(network) for _, network in cascade.passes()] == [id(first), id(second), id(second)]
    early = replace(CONFIG.stages[1], coverage=CONFIG.stages[1].early_coverage)
    assert [stage for stage, _ in cascade.passes()] == [CONFIG.stages[0], early, CONFIG.stages[1]]


def test_inference_form_answers_as_evaluation_mode_and_leaves_the_original() -> None:
    torch.manual_seed(0)
    cascade = Cascade(CONFIG).train()
    signed_scales(cascade)
    before = {name: tensor.clone() for name, tensor in cascade.state_dict().items()}
    twin = cascade.for_inference()
    assert twin.config == CONFIG
    assert not any(module.training for module in twin.modules())
    assert not any(parameter.requires_grad for parameter in twin.parameters())
    assert not any(isinstance(module, torch.nn.BatchNorm1d) for module in twin.modules())
    assert cascade.training
    assert all(torch.equal(tensor, before[name]) for name, tensor in cascade.state_dict().items())
    cascade.eval()
    for stage, own, folded in zip(CONFIG.stages, cascade.stages, twin.stages, strict=True):
        inputs = random_patches(stage.network)
        assert (folded(*inputs) - own(*inputs)).abs().max() < 1e-4
