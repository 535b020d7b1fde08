"""Training patches: a pure function of (seed, chunk), targets in the patch frame, balance and weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from train_cases import CHUNK, clean, cube, sphere

from gcnd.data.noise import NOISE_KINDS
from gcnd.nn.cascade import PatchConfig
from gcnd.predict import PatchArrays, make_extractor
from gcnd.train import samples
from gcnd.train.samples import (
    Batch,
    CleanShape,
    FreshNoise,
    NoiseDraw,
    NoisyMesh,
    blurred,
    draw_noise,
    flip_frames,
    make_chunk,
    noisy_vertices,
    pick_faces,
)

PATCH = PatchConfig(n_nodes=32)
SCALE_PATCH = PatchConfig(n_nodes=32, scale_space=True, roughness=True)
PAPER_PATCH = PatchConfig(n_nodes=32, vertex_offsets=False, budget="random")


class FixedSource:
    """Gives the same noisy positions at every draw."""

    def __init__(self, shape: CleanShape, vertices: NDArray[np.float64]):
        self.shape, self.vertices = shape, vertices

    def draw(self, rng: np.random.Generator) -> NoisyMesh:
        return NoisyMesh.untouched(self.shape, self.vertices)


@pytest.fixture(scope="module")
def both() -> FreshNoise:
    return FreshNoise([clean(sphere()), clean(cube())])


def equal(one: Batch, other: Batch) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("patch", [PATCH, PAPER_PATCH], ids=["ours", "paper"])
def test_a_chunk_depends_on_seed_and_index_alone(both: FreshNoise, patch: PatchConfig) -> None:
    first = make_chunk(both, patch, CHUNK, seed=5, index=7)
    make_chunk(both, patch, CHUNK, seed=5, index=8)
    np.random.seed(1)  # noqa: NPY002
    torch.manual_seed(1)
    again = make_chunk(FreshNoise([clean(sphere()), clean(cube())]), patch, CHUNK, seed=5, index=7)
    assert equal(first, again)
    for seed, index in ((5, 8), (6, 7), (7, 5)):
        assert not torch.equal(make_chunk(both, patch, CHUNK, seed, index).features, first.features)


def test_shapes_and_types(both: FreshNoise) -> None:
    batch = make_chunk(both, PATCH, CHUNK, 0, 0)
    assert [(tuple(t.shape), t.dtype) for t in batch] == [
        ((16, 32, 17), torch.float32),
        ((16, 32, 3), torch.int32),
        ((16, 32, 3), torch.float32),
        ((16, 32), torch.float32),
    ]
    assert (torch.linalg.vector_norm(batch.target, dim=-1) - 1).abs().max() < 1e-6


@pytest.mark.parametrize("patch", [PATCH, PAPER_PATCH], ids=["ours", "paper"])
def test_without_noise_the_target_is_the_input_normal(patch: PatchConfig) -> None:
    shape = clean(cube())
    batch = make_chunk(FixedSource(shape, shape.vertices), patch, CHUNK, 0, 0)
    assert (batch.target - batch.features[..., 3:6]).abs().max() < 1e-6


def test_targets_turned_back_are_the_clean_normals(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = clean(sphere())
    noisy = noisy_vertices(shape, NoiseDraw("isotropic", 0.3, 0.0, 4))
    made: list[PatchArrays] = []

    class Recorded(PatchArrays):
        def __init__(self, n_patches: int, patch: PatchConfig):
            super().__init__(n_patches, patch)
            made.append(self)

    monkeypatch.setattr(samples, "PatchArrays", Recorded)
    monkeypatch.setattr(samples, "flip_frames", lambda batch, rng: batch)
    rng = np.random.default_rng(0)
    batch = samples._patches_of_one_mesh(FixedSource(shape, noisy), PATCH, 12, CHUNK, rng)
    (patches,) = made
    world = np.einsum("prc,pnc->pnr", patches.world_from_patch, batch.target.numpy())
    assert np.abs(world - shape.normals[patches.face_ids]).max() < 1e-6
    # And they are not what the noisy mesh already shows.
    assert np.abs(batch.target.numpy() - patches.features[..., 3:6]).max() > 0.1
    own = np.einsum("prc,pnc->pnr", patches.world_from_patch, patches.features[..., :3])
    centroids = noisy[shape.faces].mean(axis=1)
    offsets = centroids[patches.face_ids] - centroids[patches.face_ids[:, :1]]
    assert np.abs(own - offsets / patches.radii[:, None, None]).max() < 1e-6


# --- turning frames ----------------------------------------------------------------------------------


@pytest.mark.parametrize("patch", [PATCH, SCALE_PATCH, PAPER_PATCH], ids=["offsets", "scale space", "paper"])
def test_turned_frames_describe_the_same_patches(
    both: FreshNoise, patch: PatchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(samples, "flip_frames", lambda batch, rng: batch)
        before = make_chunk(both, patch, replace(CHUNK, n_patches=64), 0, 0)
    after = flip_frames(Batch(*(t.clone() for t in before)), np.random.default_rng(3))
    half_turn = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    of_mesh = 4 * patch.roughness
    starts = [0, 3, *(8 + 3 * i for i in range((patch.n_channels - 8 - of_mesh) // 3))]
    assert torch.equal(after.features[..., 6:8], before.features[..., 6:8])
    n_own = patch.n_channels - of_mesh
    assert torch.equal(after.features[..., n_own:], before.features[..., n_own:])
    turned = 0
    for p in range(64):
        vectors = [(after.features[p, :, s : s + 3], before.features[p, :, s : s + 3]) for s in starts]
        vectors.append((after.target[p], before.target[p]))
        as_before = all(torch.equal(a, b) for a, b in vectors)
        as_turned = all(torch.equal(a @ half_turn, b) for a, b in vectors)
        assert as_before != as_turned
        turned += as_turned
    assert 20 <= turned <= 44
    scalars = [6, 7]
    assert torch.equal(after.features[..., scalars], before.features[..., scalars])
    assert torch.equal(after.neighbors, before.neighbors)
    assert torch.equal(after.weight, before.weight)


def test_turning_is_seeded_and_turning_twice_is_nothing(both: FreshNoise) -> None:
    batch = make_chunk(both, PATCH, CHUNK, 0, 0)
    original = Batch(*(t.clone() for t in batch))
    flip_frames(batch, np.random.default_rng(9))
    assert not equal(batch, original)
    flip_frames(batch, np.random.default_rng(9))
    assert equal(batch, original)


# --- which faces -------------------------------------------------------------------------------------


def test_three_feature_faces_to_every_two_others() -> None:
    shape = clean(cube(12))
    assert min(len(shape.feature_faces), len(shape.flat_faces)) > 400
    assert not set(shape.feature_faces) & set(shape.flat_faces)
    assert len(shape.feature_faces) + len(shape.flat_faces) == len(shape.faces)
    picked = pick_faces(shape, 1000, 1.5, np.random.default_rng(0))
    assert picked.dtype == np.uint32
    assert len(picked) == 1000
    assert np.isin(picked, shape.feature_faces).sum() == 600
    assert np.isin(picked, shape.flat_faces).sum() == 400


def test_feature_faces_of_a_cube_lie_at_its_edges() -> None:
    shape = clean(cube(12))
    near = np.sort(0.5 - np.abs(shape.vertices[shape.faces]), axis=2)[..., 1].min(axis=1)
    assert near[shape.feature_faces].max() < 0.3
    assert (near[shape.flat_faces] > 0.05).mean() > 0.9


def test_few_feature_faces_are_picked_five_times_each() -> None:
    shape = clean(cube(12))
    shape.feature_faces = shape.feature_faces[:10]
    picked = pick_faces(shape, 1000, 1.5, np.random.default_rng(0))
    assert np.isin(picked, shape.feature_faces).sum() == 50
    assert len(picked) == 1000


def no_features(shape: CleanShape) -> CleanShape:
    shape.flat_faces, shape.feature_faces = (
        np.arange(len(shape.faces), dtype=np.uint32),
        np.array([], np.uint32),
    )
    return shape


def only_features(shape: CleanShape) -> CleanShape:
    shape.feature_faces, shape.flat_faces = (
        np.arange(len(shape.faces), dtype=np.uint32),
        np.array([], np.uint32),
    )
    return shape


@pytest.mark.parametrize(
    ("change", "ratio"), [(no_features, 1.5), (only_features, 1.5), (lambda shape: shape, None)]
)
def test_without_two_groups_all_faces_are_alike(
    change: Callable[[CleanShape], CleanShape], ratio: float | None
) -> None:
    shape = change(clean(cube()))
    picked = pick_faces(shape, 43_200, ratio, np.random.default_rng(0))
    assert picked.dtype == np.uint32
    counts = np.bincount(picked, minlength=len(shape.faces))
    assert len(counts) == len(shape.faces) == 432
    assert 50 < counts.min() <= counts.max() < 160  # 100 each, five standard deviations


# --- weights -----------------------------------------------------------------------------------------


def test_repeats_and_faces_without_normal_weigh_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = clean(cube(1))  # 12 faces for 32 nodes
    shape.normals = shape.normals.copy()
    shape.normals[5] = 0.0
    made: list[PatchArrays] = []

    class Recorded(PatchArrays):
        def __init__(self, n_patches: int, patch: PatchConfig):
            super().__init__(n_patches, patch)
            made.append(self)

    monkeypatch.setattr(samples, "PatchArrays", Recorded)
    source = FixedSource(shape, shape.vertices)
    batch = samples._patches_of_one_mesh(source, PATCH, 6, CHUNK, np.random.default_rng(0))
    (patches,) = made
    weight = batch.weight.numpy()
    centroids = shape.vertices[shape.faces].mean(axis=1)
    distance = (
        np.linalg.norm(centroids[patches.face_ids] - centroids[patches.face_ids[:, :1]], axis=2)
        / patches.radii[:, None]
    )
    used = (patches.mask == 1) & (patches.face_ids != 5)
    assert (patches.mask.sum(axis=1) <= 12).all()
    assert (weight[patches.mask == 0] == 0).all()
    assert (weight[patches.face_ids == 5] == 0).all()
    assert np.abs(weight[used] - np.exp(-2 * distance[used] ** 2)).max() < 1e-6


# --- noise -------------------------------------------------------------------------------------------


def test_noise_as_training_sees_it() -> None:
    rng = np.random.default_rng(0)
    meshes = [draw_noise(rng) for _ in range(4000)]
    first = [noise[0].kind for noise in meshes]
    shares = [np.mean([kind == k for k in first]) for kind in NOISE_KINDS]
    assert np.abs(np.array(shares) - [0.6, 0.15, 0.1, 0.1, 0.05]).max() < 0.03
    levels = np.array([np.sqrt(sum(d.level**2 for d in noise)) for noise in meshes])
    assert levels.min() >= 0
    assert levels.max() <= 0.7
    assert abs(np.mean(levels == 0) - 0.03) < 0.01
    faint = levels[(levels > 0) & (levels < 0.05)]
    assert abs(len(faint) / len(levels) - 0.12) < 0.02
    assert abs(np.mean(faint < np.sqrt(1e-3 * 0.05)) - 0.5) < 0.08
    assert abs(np.mean(levels > 0.4) - 0.1) < 0.02
    draws = [d for noise in meshes for d in noise]
    assert all(0.1 <= d.fraction <= 0.6 for d in draws)
    assert len({d.seed for d in draws}) > len(draws) - 10


def test_some_noise_in_training_is_of_two_kinds() -> None:
    rng = np.random.default_rng(1)
    meshes = [draw_noise(rng) for _ in range(4000)]
    assert {len(noise) for noise in meshes} == {1, 2}
    mixed = [noise for noise in meshes if len(noise) == 2]
    assert abs(len(mixed) / len(meshes) - 0.15) < 0.02
    assert all(a.kind != b.kind and a.seed != b.seed for a, b in mixed)
    angles = [np.arctan2(b.level, a.level) for a, b in mixed if a.level + b.level > 0]
    assert abs(np.mean(angles) - np.pi / 4) < 0.06
    assert min(angles) < 0.1
    assert max(angles) > np.pi / 2 - 0.1


def test_mixed_noise_adds_up_on_the_clean_mesh() -> None:
    shape = clean(sphere())
    noises = (NoiseDraw("gaussian", 0.2, 0.0, 1), NoiseDraw("isotropic", 0.1, 0.0, 2))
    offsets = [noisy_vertices(shape, noise) - shape.vertices for noise in noises]
    assert all(np.abs(offset).max() > 0 for offset in offsets)
    both = noisy_vertices(shape, *noises) - shape.vertices
    assert np.abs(both - sum(offsets)).max() < 1e-12


def test_shapes_are_drawn_by_kind_and_weight() -> None:
    ball, cubes = clean(sphere()), [clean(cube(2)) for _ in range(3)]
    rough = replace(ball, name="rough", kind="feature", draw_weight=1.0)
    rougher = replace(rough, name="rougher", draw_weight=3.0)
    source = FreshNoise([*cubes, ball, rough, rougher])
    rng = np.random.default_rng(0)
    names = [source.draw(rng)[0].name for _ in range(2000)]
    shares = {name: names.count(name) / 2000 for name in ("cube", "sphere", "rough", "rougher")}
    assert shares == pytest.approx({"cube": 0.3, "sphere": 0.3, "rough": 0.1, "rougher": 0.3}, abs=0.035)


def test_noise_moves_the_vertices_of_the_clean_mesh() -> None:
    shape = clean(sphere())
    moved = noisy_vertices(shape, NoiseDraw("gaussian", 0.2, 0.0, 1))
    radial = np.linalg.norm(moved, axis=1) - 0.5
    edge = shape.noise.mean_edge
    assert abs(radial.std() / edge - 0.2) < 0.03
    assert np.array_equal(moved, noisy_vertices(shape, NoiseDraw("gaussian", 0.2, 0.0, 1)))
    assert np.array_equal(shape.vertices, sphere().vertices)


def test_roughness_is_blurred_only_where_a_network_sees_it() -> None:
    own = np.array([0.01, 0.02, 0.04, 0.1])
    rng = np.random.default_rng(0)
    logs = np.log10([blurred(own, rng) / own for _ in range(4000)])
    assert np.abs(logs.mean(axis=0)).max() < 0.005
    assert np.abs(logs.std(axis=0) - np.hypot(0.05, 0.03)).max() < 0.003
    # What all four share, and what each has of its own.
    assert abs(logs.mean(axis=1).std() - np.hypot(0.05, 0.03 / 2)) < 0.003
    shape = clean(sphere())
    source = FixedSource(shape, noisy_vertices(shape, NoiseDraw("gaussian", 0.2, 0.0, 1)))
    told = make_chunk(source, SCALE_PATCH, CHUNK, 0, 0).features[:, 0, -4:]
    exact = make_extractor(shape.topology, source.vertices, SCALE_PATCH, 0)
    patches = PatchArrays(len(shape.faces), SCALE_PATCH)
    patches.fill(exact, np.arange(len(shape.faces), dtype=np.uint32))
    difference = told.mean(0).numpy() - patches.features[:, 0, -4:].mean(0)
    assert 1e-3 < np.abs(difference).max() < 0.3
