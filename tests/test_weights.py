"""Weight files: what is written is what is read, whatever else is refused, and the shipped ones still answer."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn
from typer.testing import CliRunner

import denoise_cases
from gcnd.auto import CANDIDATES
from gcnd.cli import app
from gcnd.denoise import denoise
from gcnd.errors import ConfigError, GcndError, WeightsError
from gcnd.nn.cascade import Cascade, CascadeConfig, RefinementConfig
from gcnd.nn.networks import NetworkConfig
from gcnd.weights import list_models, load_cascade, registry, save_cascade
from gcnd.weights.files import load_header, load_tensors, save_tensors

CONFIG = replace(denoise_cases.CONFIG, refinement=RefinementConfig(4, 0.15, 1.5), vertex_iterations=7)


def make_cascade(seed: int = 0) -> Cascade:
    torch.manual_seed(seed)
    cascade = Cascade(CONFIG)
    for module in cascade.modules():
        if isinstance(module, nn.BatchNorm1d):
            nn.init.normal_(module.weight)
            nn.init.normal_(module.running_mean)
            nn.init.uniform_(module.running_var, 0.5, 2.0)
    for network in cascade.stages:
        nn.init.normal_(network.out.weight, std=0.3)
    return cascade.eval()


def inputs(config: NetworkConfig) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    features = torch.randn(3, 24, config.in_channels, generator=generator)
    return features, torch.randint(24, (3, 24, 3), dtype=torch.int32, generator=generator)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    found = tmp_path / "tiny.safetensors"
    save_cascade(found, make_cascade(), {"recipe": "tiny"})
    return found


# --- round trips -------------------------------------------------------------------------------------


def test_a_cascade_comes_back_folded_and_answers_the_same(path: Path) -> None:
    loaded = load_cascade(str(path))
    assert loaded.config == CONFIG
    assert not any(module.training for module in loaded.modules())
    assert not any(isinstance(module, nn.BatchNorm1d) for module in loaded.modules())
    for stage, own, found in zip(CONFIG.stages, make_cascade().stages, loaded.stages, strict=True):
        expected = own(*inputs(stage.network))
        assert expected.std() > 0.05
        assert (found(*inputs(stage.network)) - expected).abs().max() < 1e-4


def test_the_file_holds_exactly_the_weights_and_the_header(path: Path) -> None:
    tensors, header = load_tensors(path)
    expected = make_cascade().state_dict()
    assert tensors.keys() == expected.keys()
    assert all(torch.equal(tensors[name], tensor) for name, tensor in expected.items())
    assert all(tensors[name].dtype == tensor.dtype for name, tensor in expected.items())
    assert header["layout"] == registry.LAYOUT_VERSION == 2
    assert header["recipe"] == "tiny"
    assert CascadeConfig.from_dict(header["cascade"]) == CONFIG
    assert load_header(path) == header
    assert os.listdir(path.parent) == ["tiny.safetensors"]


def test_tensors_of_any_layout_are_written_as_they_read(tmp_path: Path) -> None:
    matrix = torch.arange(12.0).view(3, 4)
    tensors = {
        "turned": matrix.T,
        "strided": matrix[:, ::2],
        "learnt": nn.Parameter(torch.ones(2)),
        "count": torch.tensor(7),
        "half": torch.tensor([1.5, -2.0], dtype=torch.bfloat16),
    }
    save_tensors(tmp_path / "x.safetensors", tensors, {"a": [1, "é"]})
    found, header = load_tensors(tmp_path / "x.safetensors")
    assert header == {"a": [1, "é"]}
    assert all(torch.equal(found[name], tensor) for name, tensor in tensors.items())


def test_a_failed_write_leaves_the_old_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = path.read_bytes()

    def fail(*_: Any) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        save_cascade(path, make_cascade(seed=1))
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]


# --- what is refused ---------------------------------------------------------------------------------


def refused(preset: Path | str, message: str, error: type[GcndError] = WeightsError) -> None:
    with pytest.raises(error, match=message) as caught:
        load_cascade(str(preset))
    assert caught.value.hint is None or len(caught.value.hint) > 5
    with pytest.raises(error, match=message):
        denoise((np.eye(3), np.array([[0, 1, 2]])), preset=str(preset))


def test_a_missing_file(tmp_path: Path) -> None:
    refused(tmp_path / "none.safetensors", r"no such weights file: .*none\.safetensors")
    (tmp_path / "folder.safetensors").mkdir()
    refused(tmp_path / "folder.safetensors", "no such weights file")


@pytest.mark.parametrize("kept", [0, 4, 100, 0.5, 0.999])
def test_a_truncated_file(path: Path, kept: float) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: kept if isinstance(kept, int) else int(kept * len(whole))])
    refused(path, r"cannot read .*tiny\.safetensors")


class Trap:
    """Runs a command when unpickled."""

    def __init__(self, target: Path):
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.target),)


def test_a_pickle_is_refused_and_not_run(tmp_path: Path) -> None:
    bait, path = tmp_path / "executed", tmp_path / "pickle.safetensors"
    torch.save({"weights": torch.ones(2), "trap": Trap(bait)}, path)
    refused(path, r"cannot read .*pickle\.safetensors")
    assert not bait.exists()


def test_safetensors_of_somebody_else(tmp_path: Path) -> None:
    path = tmp_path / "foreign.safetensors"
    save_file({"x": torch.ones(2)}, path)
    refused(path, "does not say which networks it holds")
    save_file({"x": torch.ones(2)}, path, metadata={"gcnd": "{not json"})
    refused(path, r"cannot read .*foreign\.safetensors")


def rewritten(path: Path, **changes: Any) -> Path:
    tensors, header = load_tensors(path)
    save_tensors(path, tensors, {**header, **changes})
    return path


def test_another_feature_layout(path: Path) -> None:
    refused(rewritten(path, layout=1), "has feature layout 1, this version of gcnd reads 2")
    refused(rewritten(path, layout=None), "has feature layout None")


def test_a_configuration_that_is_not_known(path: Path) -> None:
    config = CONFIG.to_dict()
    refused(rewritten(path, cascade=None), "no cascade configuration")
    refused(
        rewritten(path, cascade={**config, "stages": [{"network": {}}]}), "does not know.*no architecture"
    )
    without_patch = {"network": config["stages"][0]["network"]}
    refused(rewritten(path, cascade={**config, "stages": [without_patch]}), "does not know.*patch")
    stage = {**config["stages"][0], "network": {**config["stages"][0]["network"], "heads": 8}}
    refused(rewritten(path, cascade={**config, "stages": [stage]}), "heads")
    stage["network"] = {**config["stages"][0]["network"], "architecture": "perceptron"}
    refused(rewritten(path, cascade={**config, "stages": [stage]}), "architecture is 'perceptron'")


@pytest.mark.parametrize("change", ["missing", "extra", "shape"])
def test_tensors_that_do_not_fit_are_named(path: Path, change: str) -> None:
    tensors, header = load_tensors(path)
    name = "stages.0.pool.linear.weight"
    message = {
        "missing": rf"{name} has shape None, expected \(16, 28\)",
        "extra": r"stages\.9\.bias has shape \(2,\), expected None",
        "shape": rf"{name} has shape \(16, 27\), expected \(16, 28\)",
    }[change]
    if change == "missing":
        del tensors[name]
    elif change == "extra":
        tensors["stages.9.bias"] = torch.ones(2)
    else:
        tensors[name] = tensors[name][:, :27]
    save_tensors(path, tensors, header)
    refused(path, message)


@pytest.mark.parametrize("preset", ["papers", "", "../default", "sub/default", "default.pth"])
def test_an_unknown_preset(preset: str) -> None:
    """Preset "auto" is named where it is one: it stands for weights, and is no file of them."""
    refused(
        preset,
        "unknown preset .*, allowed: (auto, )?default, fast, paper, paper-scan, scan or the path",
        ConfigError,
    )
    with pytest.raises(ConfigError, match=": default, fast"):
        load_cascade(preset)
    with pytest.raises(ConfigError, match=": auto, default, fast"):
        denoise((np.eye(3), np.array([[0, 1, 2]])), preset=preset)


def test_a_device_that_is_not_there(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for device, message in (
        ("cuda", "cuda is not available here"),
        ("gpu7", "unknown device 'gpu7'"),
        ("meta", "device 'meta' is not"),
    ):
        with pytest.raises(ConfigError, match=message):
            load_cascade(str(path), device)
        with pytest.raises(ConfigError, match=message):
            denoise((np.eye(3), np.array([[0, 1, 2]])), preset=str(path), device=device)


# --- shipped presets, in a folder of the test's ------------------------------------------------------


@pytest.fixture
def shipped(path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that ships `path` as the preset "tiny"."""
    card = {
        "description": "for a test",
        "n_parameters": 123,
        "licence": "CC0-1.0",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }
    path.with_suffix(".json").write_text(json.dumps(card), encoding="utf-8")
    monkeypatch.setattr(registry, "_FOLDER", path.parent)
    monkeypatch.setattr(registry, "_SHIPPED", ("tiny",))
    return path.parent


def test_a_shipped_preset_loads_by_name_and_by_path(shipped: Path) -> None:
    assert load_cascade("tiny").config == CONFIG
    assert load_cascade(str(shipped / "tiny.safetensors")).config == CONFIG
    (model,) = list_models()
    assert (model.name, model.description, model.n_parameters) == ("tiny", "for a test", 123)
    assert (model.licence, model.auto) == ("CC0-1.0", False)
    assert model.file_bytes == (shipped / "tiny.safetensors").stat().st_size
    assert model.sha256 == model.card["sha256"]


def test_a_shipped_file_with_another_hash(shipped: Path) -> None:
    path = shipped / "tiny.safetensors"
    whole = bytearray(path.read_bytes())
    whole[-1] ^= 1  # one bit of one weight
    path.write_bytes(whole)
    refused("tiny", "does not have the hash that its card states")


@pytest.mark.parametrize(
    ("missing", "message"), [("tiny.json", "model card"), ("tiny.safetensors", "no such weights file")]
)
def test_a_shipped_preset_with_a_file_missing(shipped: Path, missing: str, message: str) -> None:
    (shipped / missing).unlink()
    refused("tiny", message)


# --- the shipped weights themselves ------------------------------------------------------------------


@pytest.mark.parametrize("name", registry._SHIPPED)
def test_golden_answers_of_the_shipped_weights(name: str) -> None:
    cascade = load_cascade(name)
    with np.load(registry._FOLDER / f"{name}.golden.npz", allow_pickle=False) as golden:
        features = torch.from_numpy(golden["features"])
        neighbors = torch.from_numpy(golden["neighbors"])
        expected = [golden[f"stage{number}"] for number in range(1, len(cascade.stages) + 1)]
    assert features.dtype == torch.float32
    assert neighbors.dtype == torch.int32
    for stage, network, answer in zip(cascade.config.stages, cascade.stages, expected, strict=True):
        with torch.inference_mode():
            found = network(features[..., : stage.patch.n_channels], neighbors).numpy()
        assert found.shape == answer.shape
        assert np.abs(found - answer).max() < 1e-4
        # The golden answers are no input normals, and differ from patch to patch by far more than they may be off.
        own = features[..., 3:6].numpy() if answer.ndim == 3 else features[:, 0, 3:6].numpy()
        assert np.abs(answer - own).max() > 0.05
        assert answer.reshape(-1, 3).std(axis=0).min() > 0.02


@pytest.mark.parametrize("name", registry._SHIPPED)
def test_the_card_states_what_the_file_holds(name: str) -> None:
    models = {model.name: model for model in list_models()}
    path = registry._FOLDER / f"{name}.safetensors"
    tensors, header = load_tensors(path)
    config = CascadeConfig.from_dict(header["cascade"])
    assert models[name].sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert models[name].n_parameters == sum(p.numel() for p in Cascade(config).parameters())
    assert all(torch.isfinite(tensor).all() for tensor in tensors.values() if tensor.is_floating_point())
    assert len(models[name].description) > 10
    assert {model.name for model in list_models() if model.auto} == {*CANDIDATES}


def test_every_card_can_be_shown() -> None:
    run = CliRunner().invoke(app, ["models"])
    assert run.exit_code == 0, run.exception
    for name in registry._SHIPPED:
        assert f"\n{name}" in f"\n{run.stdout}"
    assert run.stdout.count("openly licensed meshes") == len(registry._SHIPPED)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16])
def test_weights_are_what_they_are_whatever_torch_makes_by_default(dtype: torch.dtype) -> None:
    mesh = (denoise_cases.VERTICES, denoise_cases.FACES)
    plain = denoise(mesh, preset="fast")[0]
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        with torch.device("meta"):
            cascade = load_cascade("fast")
        assert {p.device.type for p in cascade.parameters()} == {"cpu"}
        assert {p.dtype for p in cascade.parameters()} == {torch.float32}
        assert np.array_equal(denoise(mesh, preset="fast")[0], plain)
    finally:
        torch.set_default_dtype(before)
