"""Pairs to train on: the same for a seed, kept on disk, made again when they no longer fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scan_cases import ball

from gcnd.data.shapes import Shape
from gcnd.errors import ConfigError, MeshError
from gcnd.scans import SCAN_KINDS, Fusion, Kinect1, Kinect2, Print, training
from gcnd.scans.training import (
    KIND_SHARES,
    TrainingPair,
    draw_scan,
    load_training_pairs,
    training_pair,
)


def shapes() -> list[Shape]:
    small, large = ball(2), ball(3)
    return [Shape("small", "smooth", *small), Shape("large", "smooth", large[0] * [1, 1, 2], large[1])]


def same(a: TrainingPair, b: TrainingPair) -> bool:
    return a[:2] == b[:2] and all(np.array_equal(x, y) for x, y in zip(a[2:], b[2:], strict=True))


def test_a_pair_depends_on_seed_and_number_alone() -> None:
    first = training_pair(shapes(), 3, 5, "kinect2")
    assert same(first, training_pair(shapes(), 3, 5, "kinect2"))
    assert first.name.endswith("-kinect2-5")
    assert not same(first, training_pair(shapes(), 3, 6, "kinect2"))
    assert not same(first, training_pair(shapes(), 4, 5, "kinect2"))


def test_kinds_and_meshes_are_drawn_by_their_shares() -> None:
    meshes = shapes()
    jobs = [training._job(meshes, 0, number, None) for number in range(2000)]
    shares = [np.mean([job.kind == kind for job in jobs]) for kind in SCAN_KINDS]
    np.testing.assert_allclose(shares, KIND_SHARES, atol=0.03)
    assert abs(np.mean([job.name == "small" for job in jobs]) - 0.5) < 0.03


def test_settings_are_drawn_within_what_a_scan_allows() -> None:
    rng = np.random.default_rng(0)
    types = {"kinect1": Kinect1, "kinect2": Kinect2, "fusion": Fusion, "print": Print}
    for kind in SCAN_KINDS:
        draws = [draw_scan(kind, rng) for _ in range(300)]
        assert {type(draw.setting) for draw in draws} == {types[kind]}
        for draw in draws:
            sensor = draw.setting.sensor if isinstance(draw.setting, Fusion) else draw.setting
            if not isinstance(sensor, Print):
                assert draw.distance >= draw.size / 2 + sensor.nearest
                # The whole bounding sphere is in the image.
                half_angle = np.arctan((sensor.camera.height / 2) / sensor.camera.focal)
                assert draw.size / 2 < draw.distance * np.sin(half_angle)
        assert len({draw.setting for draw in draws}) == 300
    frames = [draw_scan("kinect1", rng) for _ in range(300)]
    assert {draw.diagonal for draw in frames} == {"down", "up", "shorter"}
    assert {draw.setting.steps_per_pixel for draw in frames if isinstance(draw.setting, Kinect1)} == {
        8,
        16,
        32,
    }


def test_pairs_come_back_from_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = ("print", "kinect2")
    made = load_training_pairs(shapes(), 3, 1, tmp_path, kinds=kinds, workers=1)
    assert [pair.kind for pair in made] == ["print", "kinect2", "print"]
    assert same(made[1], training_pair(shapes(), 1, 1, "kinect2"))
    monkeypatch.setattr(training, "_make", None)
    read = load_training_pairs(shapes(), 3, 1, tmp_path, kinds=kinds)
    assert all(same(a, b) for a, b in zip(made, read, strict=True))


def test_files_of_other_meshes_and_damaged_ones_are_made_again(tmp_path: Path) -> None:
    load_training_pairs(shapes(), 2, 1, tmp_path, kinds=("print",), workers=1)
    moved = [Shape(s.name, s.kind, s.vertices + 1, s.faces) for s in shapes()]
    again = load_training_pairs(moved, 2, 1, tmp_path, kinds=("print",), workers=1)
    assert all(pair.clean_vertices.min() > -1.1 and pair.clean_vertices.mean() > 0.9 for pair in again)
    sorted(tmp_path.glob("*.npz"))[0].write_bytes(b"cut short")
    assert same(load_training_pairs(moved, 2, 1, tmp_path, kinds=("print",), workers=1)[0], again[0])
    other = load_training_pairs(moved, 1, 1, tmp_path, kinds=("kinect2",), workers=1)
    assert other[0].kind == "kinect2"


def test_other_processes_make_the_same(tmp_path: Path) -> None:
    made = load_training_pairs(shapes(), 2, 7, tmp_path, kinds=("print",), workers=2)
    assert all(same(made[n], training_pair(shapes(), 7, n, "print")) for n in range(2))


def test_scans_of_too_few_faces_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "FEWEST_FACES", 10**9)
    with pytest.raises(MeshError, match=r"10 kinect2 scans of (small|large) had fewer than 1000000000 faces"):
        training_pair(shapes(), 0, 0, "kinect2")
    assert len(training_pair(shapes(), 0, 0, "print").faces) in (320, 1280)


def test_wrong_numbers_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no clean mesh to scan"):
        training_pair([], 0, 0)
    with pytest.raises(ConfigError, match="scan -1 of seed 0"):
        training_pair(shapes(), 0, -1)
    with pytest.raises(ConfigError, match="scan 0 of seed -2"):
        load_training_pairs(shapes(), 1, -2, tmp_path)
    with pytest.raises(ConfigError, match="cannot load -1 scans with 2 workers"):
        load_training_pairs(shapes(), -1, 0, tmp_path)
    with pytest.raises(ConfigError, match="cannot load 1 scans with 0 workers"):
        load_training_pairs(shapes(), 1, 0, tmp_path, workers=0)


# --- scans that end anywhere ---------------------------------------------------------------------------


def grid_pair(n: int = 60) -> TrainingPair:
    """A flat grid of 2 n² faces, one vertex beside it that no face uses, and a noisy version."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    clean = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    ids = np.arange(x.size).reshape(n + 1, n + 1)
    a, b, c, d = ids[:-1, :-1].ravel(), ids[:-1, 1:].ravel(), ids[1:, 1:].ravel(), ids[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.uint32)
    noisy = clean + np.random.default_rng(0).normal(0, 0.1, clean.shape)
    return TrainingPair("grid-kinect2-1", "kinect2", clean, noisy, faces)


def test_a_cropped_scan_is_part_of_the_scan() -> None:
    pair = grid_pair()
    part = training.cropped(pair, 3)
    low, high = training.CROPPED_SHARE
    assert low * len(pair.faces) - 1 <= len(part.faces) <= high * len(pair.faces) + 1
    assert len(part.faces) >= training.FEWEST_FACES
    corners = {tuple(face) for face in pair.noisy_vertices[pair.faces].reshape(-1, 9).tolist()}
    assert all(tuple(face) in corners for face in part.noisy_vertices[part.faces].reshape(-1, 9).tolist())
    assert set(part.faces.ravel().tolist()) == set(range(len(part.clean_vertices)))
    # Truth and scan are still of one another: on this grid they differ by the noise alone.
    assert np.abs(part.clean_vertices - part.noisy_vertices).max() < 0.6
    assert not np.any(part.clean_vertices[:, 2])


def test_a_crop_is_drawn_and_round() -> None:
    pair = grid_pair()
    first, again, other = (training.cropped(pair, seed) for seed in (1, 1, 2))
    assert same(first, again)
    assert not np.array_equal(first.clean_vertices, other.clean_vertices)
    centroids = first.clean_vertices[first.faces].mean(axis=1)
    left_out = {tuple(c) for c in pair.clean_vertices[pair.faces].mean(axis=1).tolist()} - {
        tuple(c) for c in centroids.tolist()
    }
    centre = np.argmin([np.linalg.norm(centroids - c, axis=1).max() for c in centroids])
    farthest_in = np.linalg.norm(centroids - centroids[centre], axis=1).max()
    nearest_out = np.linalg.norm(np.array(sorted(left_out)) - centroids[centre], axis=1).min()
    assert farthest_in <= nearest_out + 1e-9


def test_a_small_scan_stays_whole() -> None:
    pair = grid_pair(30)
    assert training.cropped(pair, 0) is pair


def test_a_scan_that_fails_is_drawn_again_and_told_when_all_do(monkeypatch: pytest.MonkeyPatch) -> None:
    simulate, calls = training.simulate, 0

    def fails(n: int) -> None:
        def failing(*arguments: object, **options: object) -> object:
            nonlocal calls
            calls += 1
            if calls <= n:
                raise MeshError(f"no surface in scan {calls}")
            return simulate(*arguments, **options)  # type: ignore[arg-type]

        monkeypatch.setattr(training, "simulate", failing)

    fails(2)
    assert training_pair(shapes(), 3, 5, "print").name.endswith("-print-5")
    assert calls == 3
    calls = 0
    fails(10)
    with pytest.raises(
        MeshError,
        match=r"10 print scans of \w+ failed or had fewer than 2000 faces, one of them: no surface in scan 10",
    ):
        training_pair(shapes(), 3, 5, "print")
