"""`gcnd.Denoiser`: weights held for many meshes, shared by threads, pickled to processes; confidence by face."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
import torch
import trimesh
from scipy.stats import spearmanr
from torch import nn

import gcnd
from gcnd import Controls, Denoiser, _geom, denoise
from gcnd.data.noise import add_noise
from gcnd.errors import Cancelled, ConfigError, WeightsError
from gcnd.metrics import normal_angles
from gcnd.nn.cascade import Cascade, CascadeConfig, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import NetworkConfig
from gcnd.predict import agreement
from gcnd.stages import Stages
from gcnd.weights import save_cascade, weights_hash

NODES = StageConfig(
    NetworkConfig("nodes", 17, (8,), (8, 12), 16, (12, 8), 4, "node"), PatchConfig(n_nodes=32)
)
CENTRE = StageConfig(
    NetworkConfig("centre", 8, (8,), (12,), 16, (12, 8), 4, "edge"),
    PatchConfig(n_nodes=16, vertex_offsets=False),
)
BALL = trimesh.creation.icosphere(subdivisions=3)
FACES = BALL.faces.astype(np.uint32)
VERTICES = add_noise(np.array(BALL.vertices), FACES, level=0.3, seed=1)


def save_random(path: Path, *stages: StageConfig, seed: int = 0) -> str:
    torch.manual_seed(seed)
    cascade = Cascade(CascadeConfig(stages, RefinementConfig(2, 0.3, 1.5), vertex_iterations=5)).eval()
    for network in cascade.stages:
        nn.init.normal_(network.out.weight, std=0.3)
    save_cascade(path, cascade)
    return str(path)


@pytest.fixture(scope="module")
def preset(tmp_path_factory: pytest.TempPathFactory) -> str:
    return save_random(
        tmp_path_factory.mktemp("weights") / "a.safetensors", replace(NODES, passes=2, coverage=1.5)
    )


def moved_by(options: dict[str, Any], preset: str) -> np.ndarray:
    return denoise((VERTICES, FACES), preset=preset, **options)[0]


@pytest.mark.parametrize("precision", ["float16", "int8", 32])
def test_other_precisions_are_refused(precision: Any) -> None:
    with pytest.raises(ConfigError, match=r"precision is .*, allowed: float32, bfloat16 or None"):
        Denoiser("fast", precision=precision)


def test_controls_of_another_kind_are_refused(preset: str) -> None:
    with pytest.raises(ConfigError, match=r"controls is .*, allowed: gcnd.Controls or None"):
        Denoiser(preset, controls={"strength": 0.5})  # type: ignore[arg-type]


def test_numbers_of_numpy_are_as_good(preset: str) -> None:
    options = {"seed": 2, "normal_iterations": 1, "vertex_iterations": 2}
    for kind in (np.int64, np.uint8):
        own = Denoiser(preset, **{name: kind(value) for name, value in options.items()})  # type: ignore[arg-type]
        done = own.run((VERTICES, FACES))
        assert json.loads(json.dumps(done.report()))["method"].items() >= options.items()
        assert np.array_equal(done.after, moved_by(options, preset))
    for wrong in (np.float64(2), np.array([2, 3]), np.bool_(True)):
        with pytest.raises(ConfigError, match=r"vertex_iterations is .*, allowed: a whole number"):
            Denoiser(preset, vertex_iterations=wrong)  # type: ignore[arg-type]


def test_it_gives_what_the_function_gives(preset: str) -> None:
    options: dict[str, Any] = {"seed": 3, "normal_iterations": 1, "vertex_iterations": 4}
    denoiser = Denoiser(preset, **options)
    expected = moved_by(options, preset)
    for _ in range(2):
        assert np.array_equal(denoiser((VERTICES, FACES))[0], expected)
    assert not np.array_equal(Denoiser(preset)((VERTICES, FACES))[0], expected)


def test_the_function_takes_every_control(preset: str) -> None:
    full = moved_by({}, preset)
    keep = VERTICES[:, 2] > 0
    ways = np.linalg.norm(full - VERTICES, axis=1)
    half = moved_by({"strength": 0.5}, preset)
    assert np.abs(half - 0.5 * (full + VERTICES)).max() < 1e-14
    assert np.array_equal(moved_by({"strength": 0.0}, preset), VERTICES)
    assert np.array_equal(moved_by({"keep": keep}, preset), np.where(keep[:, None], VERTICES, full))
    limit = float(np.median(ways))
    found = np.linalg.norm(moved_by({"max_displacement": limit}, preset) - VERTICES, axis=1)
    assert found == pytest.approx(np.minimum(ways, limit), abs=1e-12)
    edge = _geom.mean_edge_length(VERTICES, FACES)
    in_edges = moved_by({"max_displacement_edges": limit / edge}, preset)
    assert np.linalg.norm(in_edges - VERTICES, axis=1) == pytest.approx(found, abs=1e-12)
    kept = trimesh.Trimesh(moved_by({"preserve_volume": True}, preset), FACES, process=False)
    before = trimesh.Trimesh(VERTICES, FACES, process=False)
    assert abs(trimesh.Trimesh(full, FACES, process=False).volume - before.volume) > 1e-4
    assert kept.volume == pytest.approx(before.volume, rel=1e-11)


def test_controls_of_one_run_replace_its_own(preset: str) -> None:
    denoiser = Denoiser(preset, controls=Controls(strength=0.0))
    assert np.array_equal(denoiser((VERTICES, FACES))[0], VERTICES)
    assert np.array_equal(denoiser.run((VERTICES, FACES), controls=Controls()).mesh[0], moved_by({}, preset))


def test_threads_share_one(preset: str) -> None:
    denoiser = Denoiser(preset)
    meshes = [(add_noise(np.array(BALL.vertices), FACES, level=0.2, seed=s), FACES) for s in range(6)]
    expected = [denoiser(mesh)[0] for mesh in meshes]
    n_threads = torch.get_num_threads()
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(denoiser, meshes * 2))
        left = list(pool.map(lambda _: torch.get_num_threads(), range(4)))
    for (vertices, _), wanted in zip(found, expected * 2, strict=True):
        assert np.array_equal(vertices, wanted)
    assert torch.get_num_threads() == n_threads
    assert set(left) == {n_threads}


# --- pickling ----------------------------------------------------------------------------------------


def test_a_pickle_holds_no_weights_and_gives_the_same(preset: str, tmp_path: Path) -> None:
    denoiser = Denoiser(preset, seed=5, controls=Controls(strength=0.7))
    data = pickle.dumps(denoiser)
    assert len(data) < 2000
    expected, _ = denoiser((VERTICES, FACES))
    assert np.array_equal(pickle.loads(data)((VERTICES, FACES))[0], expected)
    (tmp_path / "denoiser").write_bytes(data)
    np.savez(tmp_path / "mesh.npz", vertices=VERTICES, faces=FACES)
    code = (
        "import pickle, numpy as np; mesh = np.load('mesh.npz'); "
        "denoiser = pickle.load(open('denoiser', 'rb')); "
        "np.save('moved.npy', denoiser((mesh['vertices'], mesh['faces']))[0])"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, timeout=120)
    assert np.array_equal(np.load(tmp_path / "moved.npy"), expected)


def test_a_relative_path_holds_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_random(tmp_path / "a.safetensors", CENTRE)
    monkeypatch.chdir(tmp_path)
    data = pickle.dumps(Denoiser("a.safetensors"))
    monkeypatch.chdir("/")
    path = str(tmp_path / "a.safetensors")
    assert pickle.loads(data).hashes == {path: weights_hash(path)}


def test_other_weights_under_the_same_name_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    data = pickle.dumps(Denoiser(save_random(path, CENTRE)))
    save_random(path, CENTRE, seed=1)
    with pytest.raises(WeightsError, match=r"have hash \w{12}… here and had \w{12}…"):
        pickle.loads(data)
    path.unlink()
    with pytest.raises(WeightsError, match="no such weights file"):
        pickle.loads(data)


# --- confidence --------------------------------------------------------------------------------------


def test_confidence_comes_with_the_mesh(preset: str) -> None:
    (vertices, _), confidence = denoise((VERTICES, FACES), preset=preset, confidence=True)
    assert np.array_equal(vertices, moved_by({}, preset))
    assert confidence.shape == (len(FACES),)
    assert confidence.min() > 0.0
    assert confidence.max() < 1.0
    assert np.ptp(confidence) > 0.01


def test_confidence_ranks_the_errors_of_a_machine_part() -> None:
    # A ball cut by a plane: errors are at its one sharp edge.
    solid = manifold3d.Manifold.sphere(1.0, 128).trim_by_plane((0.3, 0.2, 1.0), -0.2).to_mesh64()
    truth, faces = _geom.remesh(
        np.ascontiguousarray(solid.vert_properties[:, :3], dtype=np.float64),
        np.ascontiguousarray(solid.tri_verts, dtype=np.uint32),
        0.065,
    )
    noisy = add_noise(truth, faces, level=0.1, seed=1)
    (vertices, _), confidence = denoise((noisy, faces), preset="fast", confidence=True)
    errors = normal_angles(vertices, truth, faces)
    rank = spearmanr(1.0 - confidence, errors).statistic
    doubtful = errors[confidence <= np.quantile(confidence, 0.1)].mean()
    print(f"{len(faces)} faces: rank correlation {rank:.2f}, {doubtful:.2f}° of {errors.mean():.2f}°")
    assert rank > 0.35
    assert doubtful > 3 * errors.mean()


def test_agreement_is_a_mean_over_compared_faces() -> None:
    # A strip of four faces, each across an edge from the next.
    faces = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]], dtype=np.uint32)
    topology = _geom.Topology(faces, 6)
    spread = np.array([0.1, 0.3, 0.0, 0.0])
    found = agreement(topology, spread)
    assert found == pytest.approx([1 - 0.2 / 2**0.5, 1 - 0.2 / 2**0.5, 1 - 0.3 / 2**0.5, 0.0])
    assert agreement(topology, np.full(4, 2**0.5)) == pytest.approx(np.zeros(4), abs=1e-12)
    assert agreement(topology, np.full(4, 1e-9)).tolist() == [0.0] * 4


def test_single_predictions_have_no_confidence(tmp_path: Path) -> None:
    preset = save_random(tmp_path / "a.safetensors", CENTRE)
    with pytest.raises(ConfigError, match="predicts each face once: there is no confidence"):
        denoise((VERTICES, FACES), preset=preset, confidence=True)
    assert Denoiser(preset).run((VERTICES, FACES)).confidence is None


# --- stages ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("answer", "stops"), [(False, True), (np.False_, True), (None, False), (0, False), ("", False)]
)
def test_only_false_cancels(preset: str, answer: Any, stops: bool) -> None:
    calls: list[float] = []

    def progress(fraction: float, stage: str) -> Any:
        calls.append(fraction)
        return answer if stage.startswith("normals, pass 2") else None

    if stops:
        with pytest.raises(Cancelled, match="cancelled at 50 %, normals, pass 2 of 2"):
            denoise((VERTICES, FACES), preset=preset, progress=progress)
        assert max(calls) == 0.5
    else:
        denoise((VERTICES, FACES), preset=preset, progress=progress)
        assert max(calls) == 1.0
    assert issubclass(gcnd.Cancelled, gcnd.GcndError)


def test_seconds_go_to_the_stage_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 1.0, 3.0, 3.5, 10.0])
    monkeypatch.setattr("gcnd.stages.time.perf_counter", lambda: next(now))
    stages = Stages()
    for stage in ("a", "b", "b", "a"):
        stages(0.0, stage)
    assert stages.seconds == {"a": 2.0, "b": 7.0}
    assert list(stages.seconds) == ["a", "b"]
