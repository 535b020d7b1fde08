"""Prediction over a whole mesh: the cover, the threads, and refinement where predictions agree."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor, nn

import gcnd.predict
from gcnd import _geom, passes
from gcnd.denoise import denoise_arrays
from gcnd.errors import ConfigError
from gcnd.flat import is_flat
from gcnd.nn.cascade import Cascade, CascadeConfig, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import NORMAL, NetworkConfig
from gcnd.predict import Prediction, predict_normals, refined

BALL = trimesh.creation.icosphere(subdivisions=3)
VERTICES, FACES = np.array(BALL.vertices), BALL.faces.astype(np.uint32)
TOPOLOGY = _geom.Topology(FACES, len(VERTICES))
STAGE = StageConfig(NetworkConfig(), PatchConfig(n_nodes=32), coverage=1.0)


class OwnNormals(nn.Module):
    """Answers with every node's own normal; remembers how many patches it saw, and in which threads."""

    def __init__(self, seconds: float = 0.0):
        super().__init__()
        self.seconds, self.n_patches, self.threads = seconds, 0, set[int]()

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        self.n_patches += len(features)
        self.threads.add(threading.get_ident())
        assert torch.get_num_threads() == 1
        # The first batch of a step is the last to finish.
        time.sleep(self.seconds * len(neighbors) / 10)
        return features[..., NORMAL].contiguous()


def test_a_cover_reaches_every_face_with_few_patches() -> None:
    network = OwnNormals()
    prediction = predict_normals(TOPOLOGY, VERTICES, STAGE, network)
    assert np.abs(prediction.normals - BALL.face_normals).max() < 1e-5
    assert 32 * network.n_patches > len(FACES)
    assert network.n_patches < 0.2 * len(FACES)
    everywhere = OwnNormals()
    stage = StageConfig(NetworkConfig(), PatchConfig(n_nodes=32))
    predict_normals(TOPOLOGY, VERTICES, stage, everywhere)
    assert everywhere.n_patches == len(FACES)


def test_batches_are_added_in_order_whichever_ends_first(monkeypatch: pytest.MonkeyPatch) -> None:
    before = torch.get_num_threads()
    monkeypatch.setitem(gcnd.predict.PATCH_NODES_A_BATCH, "cpu", 32 * 10)
    results = []
    try:
        for n_threads, seconds in ((1, 0.0), (3, 0.002)):
            torch.set_num_threads(n_threads)
            network = OwnNormals(seconds)
            results.append(predict_normals(TOPOLOGY, VERTICES, STAGE, network))
            assert len(network.threads) == n_threads
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(results[0].normals, results[1].normals)
    assert np.array_equal(results[0].spread, results[1].spread)


def test_the_callers_threads_stay_as_they_were() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        predict_normals(TOPOLOGY, VERTICES, STAGE, OwnNormals())
        found: list[int] = [torch.get_num_threads()]
        fresh = threading.Thread(target=lambda: found.append(torch.get_num_threads()))
        fresh.start()
        fresh.join()
        assert found == [3, 3]
    finally:
        torch.set_num_threads(before)


def test_an_error_in_a_batch_or_a_callback_ends_all_threads() -> None:
    class Broken(nn.Module):
        def forward(self, features: Tensor, _: Tensor) -> Tensor:
            raise RuntimeError(f"cannot take {features.shape[1]} nodes")

    def cancel(_: float) -> None:
        raise KeyboardInterrupt

    alive = threading.active_count()
    with pytest.raises(RuntimeError, match="cannot take 32 nodes"):
        predict_normals(TOPOLOGY, VERTICES, STAGE, Broken())
    with pytest.raises(KeyboardInterrupt):
        predict_normals(TOPOLOGY, VERTICES, STAGE, OwnNormals(), progress=cancel)
    assert threading.active_count() == alive


class Narrow(OwnNormals):
    """Has memory for so many patches at once."""

    def __init__(self, at_most: int):
        super().__init__()
        self.at_most = at_most

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        if len(features) > self.at_most:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return super().forward(features, neighbors)


def test_a_device_short_of_memory_gets_smaller_batches() -> None:
    wide, narrow = OwnNormals(), Narrow(3)
    expected = predict_normals(TOPOLOGY, VERTICES, STAGE, wide)
    found = predict_normals(TOPOLOGY, VERTICES, STAGE, narrow)
    assert np.array_equal(found.normals, expected.normals)
    assert narrow.n_patches == wide.n_patches > 3
    with pytest.raises(torch.OutOfMemoryError):
        predict_normals(TOPOLOGY, VERTICES, STAGE, Narrow(0))


def test_cover_says_what_it_cannot_take() -> None:
    predictions = _geom.NormalAccumulator(5)
    cover = _geom.Cover(5, 1.0, 0)
    assert cover.progress == 0.0
    first = cover.next_centers(predictions, 3)
    assert first.dtype == np.uint32
    assert len(first) == 3
    assert (np.diff(first.astype(int)) > 0).all()
    rest = cover.next_centers(predictions, 3)
    assert sorted([*first, *rest]) == [0, 1, 2, 3, 4]
    assert cover.progress == 1.0
    assert len(cover.next_centers(predictions, 3)) == 0
    with pytest.raises(ConfigError, match="predictions"):
        cover.next_centers(_geom.NormalAccumulator(4), 1)
    for bad in (0.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="least_weight"):
            _geom.Cover(5, bad, 0)


def test_a_limit_on_the_spread_keeps_normals_that_predictions_disagree_about() -> None:
    rng = np.random.default_rng(0)
    rough = BALL.face_normals + 0.2 * rng.standard_normal(BALL.face_normals.shape)
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    prediction = Prediction(rough, np.full(len(FACES), 0.3))

    def moved(**options: float) -> float:
        config = RefinementConfig(iterations=4, sigma_r=0.5, **options)  # type: ignore[arg-type]
        return float(np.linalg.norm(refined(TOPOLOGY, VERTICES, prediction, config) - rough, axis=1).mean())

    everywhere = moved()
    assert everywhere > 0.15
    assert moved(tolerance=3.0) > 0.95 * everywhere
    assert moved(tolerance=3.0, largest_spread=0.5) == moved(tolerance=3.0)
    assert moved(tolerance=3.0, largest_spread=0.03) < 0.05 * everywhere


def test_flat_meshes_alone_are_refined_where_that_is_asked_for() -> None:
    rng = np.random.default_rng(0)
    config = RefinementConfig(iterations=4, sigma_r=0.5)
    box = trimesh.creation.box().subdivide().subdivide()
    for mesh, is_refined in ((box, True), (BALL, False)):
        topology = _geom.Topology(mesh.faces.astype(np.uint32), len(mesh.vertices))
        rough = mesh.face_normals + 0.2 * rng.standard_normal(mesh.face_normals.shape)
        prediction = Prediction(rough, np.zeros(len(rough)))
        always, flat_only = (
            refined(topology, np.asarray(mesh.vertices), prediction, each)
            for each in (config, replace(config, flat_only=True))
        )
        assert np.array_equal(flat_only, always if is_refined else rough)
        assert not np.array_equal(always, rough)


@pytest.mark.parametrize(("share", "expected"), [(0.2999, False), (0.3, True), (1.0, True)])
def test_a_mesh_is_flat_where_three_tenths_of_its_edges_turn_by_no_more_than_a_degree(
    share: float, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def given(_topology: object, _vertices: object, angle: float) -> float:
        asked.append(np.degrees(angle))
        return share

    monkeypatch.setattr(_geom, "flat_share", given)
    assert is_flat(TOPOLOGY, VERTICES) == expected
    assert asked == [pytest.approx(1.0)]


class LastFeature(nn.Module):
    """Answers with every node's own normal; remembers the last four channels."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[np.ndarray] = []

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        self.seen.append(features[0, 0, -4:].numpy())
        return features[..., NORMAL].contiguous()


def test_a_network_is_told_how_rough_the_mesh_is_or_was() -> None:
    patch = PatchConfig(n_nodes=32, roughness=True)
    stage = StageConfig(NetworkConfig(in_channels=21), patch, coverage=1.0)
    own = _geom.mesh_roughness(TOPOLOGY, VERTICES)
    told = {}
    for name, given in (("nothing", None), ("own", own), ("ten times that", 10 * own)):
        network = LastFeature()
        predict_normals(TOPOLOGY, VERTICES, stage, network, roughness=given)
        told[name] = np.array(network.seen)
    assert told["own"].min() > -4
    assert told["own"].max() < 0
    assert np.array_equal(told["nothing"], told["own"])
    assert np.allclose(told["ten times that"], told["own"] + 1, atol=1e-5)
    # A network that does not ask for it does not see it.
    plain = LastFeature()
    predict_normals(TOPOLOGY, VERTICES, STAGE, plain, roughness=own)
    assert not np.allclose(plain.seen[0], told["own"][0], atol=0.1)


def test_every_pass_is_told_how_rough_the_mesh_was_at_first(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[np.ndarray] = []

    def remembered(*arguments: Any, roughness: np.ndarray, **options: Any) -> Any:
        told.append(roughness)
        return predict_normals(*arguments, roughness=roughness, **options)

    # `gcnd.denoise` is the function; the module has the same name.
    monkeypatch.setattr(passes, "predict_normals", remembered)
    stage = StageConfig(
        NetworkConfig(in_channels=21), PatchConfig(n_nodes=32, roughness=True), passes=3, coverage=1.0
    )
    noisy = VERTICES * (1 + 0.02 * np.random.default_rng(1).standard_normal((len(VERTICES), 1)))
    denoise_arrays(noisy, FACES, Cascade(CascadeConfig((stage,))))
    expected = _geom.mesh_roughness(TOPOLOGY, noisy - noisy.mean(axis=0))
    assert len(told) == 3
    assert all(np.array_equal(roughness, expected) for roughness in told)
