"""The whole line: kinds of mesh, invariances, odd input, errors, and how well the shipped weights denoise."""

from __future__ import annotations

import hashlib
import importlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from torch import nn

import gcnd
from gcnd import _geom, denoise, predict
from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.errors import ConfigError, MeshError
from gcnd.mesh_io import save
from gcnd.nn.cascade import Cascade, CascadeConfig, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import NetworkConfig
from gcnd.weights import save_cascade

Arrays = tuple[NDArray[np.float64], NDArray[np.uint32]]

NODES = NetworkConfig("nodes", 17, (8,), (8, 12), 16, (12, 8), 4, "node")
CENTRE = NetworkConfig("centre", 8, (8,), (12,), 16, (12, 8), 4, "edge")

CONFIG = CascadeConfig(
    (
        StageConfig(NODES, PatchConfig(n_nodes=32), passes=2, coverage=1.5),
        StageConfig(CENTRE, PatchConfig(n_nodes=16, vertex_offsets=False, budget="random")),
    ),
    RefinementConfig(2, 0.3, 1.5),
    vertex_iterations=5,
)

EVERY_FACE = replace(CONFIG, stages=(replace(CONFIG.stages[0], coverage=None),))
"""No face is left to chance: one patch around each, node by node."""


def random_cascade(config: CascadeConfig = CONFIG) -> Cascade:
    torch.manual_seed(0)
    cascade = Cascade(config).eval()
    for network in cascade.stages:
        nn.init.normal_(network.out.weight, std=0.3)
    return cascade


@pytest.fixture(scope="module")
def preset(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    save_cascade(path, random_cascade())
    return str(path)


def noisy_sphere(subdivisions: int = 2) -> Arrays:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    faces = mesh.faces.astype(np.uint32)
    return add_noise(np.array(mesh.vertices), faces, kind="isotropic", level=0.3, seed=2), faces


VERTICES, FACES = noisy_sphere()

EDGE = _geom.mean_edge_length(VERTICES, FACES)


@pytest.fixture(scope="module")
def result(preset: str) -> NDArray[np.float64]:
    vertices, _ = denoise((VERTICES, FACES), preset=preset)
    assert np.isfinite(vertices).all()
    assert np.abs(vertices - VERTICES).max() > 0.1 * EDGE
    return vertices


# --- kinds of mesh -----------------------------------------------------------------------------------


def test_a_trimesh_gives_a_trimesh(preset: str, result: NDArray[np.float64]) -> None:
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    mesh.visual.vertex_colors = np.arange(4 * len(VERTICES), dtype=np.uint32).reshape(-1, 4) % 256
    before = mesh.copy()
    moved = denoise(mesh, preset=preset)
    assert type(moved) is trimesh.Trimesh
    assert np.array_equal(moved.vertices, result)
    assert np.array_equal(moved.faces, FACES)
    assert np.array_equal(moved.visual.vertex_colors, before.visual.vertex_colors)
    assert np.array_equal(mesh.vertices, before.vertices)
    assert np.array_equal(mesh.faces, before.faces)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_a_pair_gives_a_pair(preset: str, library: str, dtype: Any) -> None:
    vertices, faces = VERTICES.astype(dtype), FACES.astype(np.int64)
    expected, _ = denoise((vertices.astype(np.float64), FACES), preset=preset)
    pair: Any = (vertices, faces) if library == "numpy" else (torch.tensor(vertices), torch.tensor(faces))
    moved, same = denoise(pair, preset=preset)
    assert type(moved) is type(pair[0])
    assert (moved.dtype, same.dtype) == (pair[0].dtype, pair[1].dtype)
    assert np.array_equal(np.asarray(moved), expected.astype(dtype))
    assert np.array_equal(np.asarray(same), faces)
    assert same is not pair[1]
    # The input is as it was.
    assert np.array_equal(np.asarray(pair[0]), VERTICES.astype(dtype))
    assert np.array_equal(np.asarray(pair[1]), FACES)


@pytest.mark.parametrize("kind", [str, Path])
def test_a_path_gives_a_trimesh(tmp_path: Path, preset: str, result: NDArray[np.float64], kind: Any) -> None:
    path = tmp_path / "noisy.off"
    save((VERTICES, FACES), path)
    content = path.read_bytes()
    moved = denoise(kind(path), preset=preset)
    assert type(moved) is trimesh.Trimesh
    assert np.array_equal(moved.vertices, result)
    assert np.array_equal(moved.faces, FACES)
    assert path.read_bytes() == content


@pytest.mark.parametrize("keeps", [False, True])
def test_detail_comes_back_where_the_weights_say_so(keeps: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = denoise_arrays(VERTICES, FACES, random_cascade())
    given: list[Arrays] = []

    def half_way(_: _geom.Topology, before: Any, after: Any) -> Any:
        given.append((before, after))
        return (before + after) / 2

    monkeypatch.setattr(_geom, "keep_detail", half_way)
    moved = denoise_arrays(VERTICES, FACES, random_cascade(replace(CONFIG, keep_detail=keeps)))
    assert len(given) == keeps
    np.testing.assert_allclose(moved, (plain + VERTICES) / 2 if keeps else plain, rtol=0, atol=1e-12)


# --- determinism -------------------------------------------------------------------------------------


def test_a_seed_fixes_the_result(preset: str, result: NDArray[np.float64]) -> None:
    torch.manual_seed(99)
    np.random.seed(99)  # noqa: NPY002
    assert np.array_equal(denoise((VERTICES, FACES), preset=preset, seed=0)[0], result)
    other = denoise((VERTICES, FACES), preset=preset, seed=1)[0]
    assert not np.array_equal(other, result)


PROGRAM = """
import hashlib, sys
import numpy as np, torch
torch.set_num_threads(int(sys.argv[2]))
from gcnd import denoise, predict
predict.PATCH_NODES_A_BATCH["cpu"] = 32 * 4
mesh = np.load(sys.argv[3])
print(hashlib.sha256(denoise((mesh["vertices"], mesh["faces"]), preset=sys.argv[1])[0].tobytes()).hexdigest())
"""


def test_one_thread_and_two_give_the_same_bits(
    tmp_path: Path, preset: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    vertices, faces = noisy_sphere(3)
    np.savez(tmp_path / "mesh.npz", vertices=vertices, faces=faces)
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, preset, threads, str(tmp_path / "mesh.npz")],
            env={**os.environ, "RAYON_NUM_THREADS": threads, "OMP_NUM_THREADS": threads},
            stdout=subprocess.PIPE,
            text=True,
        )
        for threads in ("1", "2")
    ]
    hashes = [run.communicate()[0].strip() for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    # Six batches between two looks at the cover: two threads have something to overtake each other with.
    monkeypatch.setitem(predict.PATCH_NODES_A_BATCH, "cpu", 32 * 4)
    own = hashlib.sha256(denoise((vertices, faces), preset=preset)[0].tobytes()).hexdigest()
    assert hashes == [own, own]


def test_the_size_of_a_batch_does_not_matter(
    preset: str, result: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(predict.PATCH_NODES_A_BATCH, "cpu", 32 * 2)
    assert np.abs(denoise((VERTICES, FACES), preset=preset)[0] - result).max() < 1e-5 * EDGE


# --- invariances -------------------------------------------------------------------------------------


def test_an_untrained_network_leaves_any_mesh_as_it_is() -> None:
    # It returns every node's own normal, so frames, averages and vertex updating must cancel exactly.
    cascade = Cascade(replace(CONFIG, stages=CONFIG.stages[:1])).eval()
    moved = denoise_arrays(VERTICES, FACES, cascade, normal_iterations=0)
    refined = denoise_arrays(VERTICES, FACES, cascade, normal_iterations=5)
    assert np.abs(moved - VERTICES).max() < 1e-6 * EDGE
    assert np.abs(refined - VERTICES).max() > 0.05 * EDGE


@pytest.mark.parametrize(("offset", "scale"), [(1e6, 1.0), (-1e6, 1.0), (0.0, 1e-6), (0.0, 1e6)])
def test_position_and_size_do_not_matter(
    preset: str, result: NDArray[np.float64], offset: float, scale: float
) -> None:
    there = VERTICES * scale + [offset, 0, -offset]
    moved = denoise((there, FACES), preset=preset)[0]
    back = (moved - [offset, 0, -offset]) / scale
    assert np.abs(back - result).max() < 1e-5 * EDGE


def test_turning_the_mesh_turns_the_result() -> None:
    turn = trimesh.transformations.rotation_matrix(1.1, [1, 2, 3])[:3, :3]
    cascade = random_cascade(EVERY_FACE)
    expected = denoise_arrays(VERTICES, FACES, cascade) @ turn.T
    assert np.abs(denoise_arrays(VERTICES @ turn.T, FACES, cascade) - expected).max() < 1e-4 * EDGE


def test_components_far_apart_do_not_see_each_other() -> None:
    cascade = random_cascade(EVERY_FACE)
    alone = denoise_arrays(VERTICES, FACES, cascade)
    other = VERTICES[:, [1, 2, 0]] * 0.7 + 100
    n = len(VERTICES)
    both = denoise_arrays(np.concatenate([VERTICES, other]), np.concatenate([FACES, FACES + n]), cascade)
    assert np.abs(both[:n] - alone).max() < 1e-5 * EDGE
    assert np.abs(both[n:] - other).max() > 0.01 * EDGE


# --- odd meshes --------------------------------------------------------------------------------------

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0.1], [1, 1, 0], [0, 1, 0.1]])

TURN = np.repeat(np.linspace(0, 2 * np.pi, 9)[:-1], 2)
SIDE = np.tile([-1 / 3, 1 / 3], 8)
WIDTH = 1 + SIDE * np.cos(TURN / 2)
STRIP = np.stack([WIDTH * np.cos(TURN), WIDTH * np.sin(TURN), SIDE * np.sin(TURN / 2)], axis=1)

ODD: dict[str, tuple[Any, Any]] = {
    "one face": (SQUARE[:3], [[0, 1, 2]]),
    "isolated vertices": (np.concatenate([SQUARE, [[5, 5, 5], [-7, 0, 1]]]), [[0, 1, 2], [0, 2, 3]]),
    "isolated vertices between": (SQUARE[[0, 0, 1, 1, 2, 3]] + np.eye(6, 3), [[0, 2, 4], [0, 4, 5]]),
    "a face of one point": (SQUARE, [[0, 1, 2], [3, 3, 3], [0, 2, 3]]),
    "a face of one edge": (SQUARE, [[0, 1, 2], [0, 3, 3]]),
    "a face on a line": (np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]]), [[0, 1, 2], [0, 2, 3]]),
    "only faces without area": (np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]]), [[0, 1, 2], [1, 1, 1]]),
    "only one point": (np.zeros((3, 3)), [[0, 1, 2]]),
    "a needle": (np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-12, 0], [0.5, 1, 0]]), [[0, 1, 2], [2, 1, 3]]),
    "the same face twice": (SQUARE, [[0, 1, 2], [0, 1, 2], [0, 2, 3]]),
    "a face and its back": (SQUARE, [[0, 1, 2], [0, 2, 1], [0, 2, 3]]),
    "three faces on one edge": (
        np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]]),
        [[0, 1, 2], [0, 1, 3], [0, 1, 4]],
    ),
    "an hourglass": (
        np.array([[0.0, 0, 0], [1, 0, 1], [0, 1, 1], [1, 0, -1], [0, 1, -1]]),
        [[0, 1, 2], [0, 3, 4]],
    ),
    "two components": (np.concatenate([SQUARE, SQUARE + 3]), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]),
    "a moebius strip": (
        STRIP,
        [
            *[[2 * i, 2 * i + 2, 2 * i + 1] for i in range(7)],
            *[[2 * i + 1, 2 * i + 2, 2 * i + 3] for i in range(7)],
            [14, 1, 15],
            [15, 1, 0],
        ],
    ),
    "mixed sizes": (
        np.concatenate([SQUARE, 1e-9 * SQUARE + 2, 1e9 * SQUARE]),
        [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10], [8, 10, 11]],
    ),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_meshes_come_back_whole(preset: str, name: str) -> None:
    vertices, faces = np.array(ODD[name][0], dtype=np.float64), np.array(ODD[name][1])
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    moved, same = denoise((vertices, faces), preset=preset)
    assert moved.shape == vertices.shape
    assert np.isfinite(moved).all()
    assert np.array_equal(same, faces)
    assert np.abs(moved - vertices).max() <= size
    isolated = np.setdiff1d(np.arange(len(vertices)), faces)
    assert np.abs(moved[isolated] - vertices[isolated]).max(initial=0) <= 1e-12 * size
    for offset, scale in ((1e6, 1.0), (0.0, 1e-6)):
        assert np.isfinite(denoise((vertices * scale + offset, faces), preset=preset)[0]).all()


def test_one_face_turns_about_its_centroid(preset: str) -> None:
    moved, _ = denoise((SQUARE[:3], np.array([[0, 1, 2]])), preset=preset)
    assert np.abs(moved.mean(axis=0) - SQUARE[:3].mean(axis=0)).max() < 1e-12
    assert np.abs(moved - SQUARE[:3]).max() > 1e-3


def test_vertices_at_one_position_move_together(preset: str, result: NDArray[np.float64]) -> None:
    # As an STL file holds it: three vertices of its own for every face, some of them at −0.
    soup, faces = VERTICES[FACES].reshape(-1, 3), np.arange(FACES.size).reshape(-1, 3)
    soup[::7] = np.where(soup[::7] == 0, -0.0, soup[::7])
    moved, _ = denoise((soup, faces), preset=preset)
    assert np.abs(moved.reshape(-1, 3, 3) - result[FACES]).max() < 1e-5 * EDGE
    first = np.zeros(len(VERTICES), dtype=int)
    first[FACES.ravel()[::-1]] = np.arange(FACES.size)[::-1]
    assert np.array_equal(moved, moved[first[FACES.ravel()]])


# --- the public name ---------------------------------------------------------------------------------


def test_the_function_is_not_hidden_by_its_module(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gcnd, "denoise", gcnd.denoise)  # put back afterwards
    monkeypatch.delitem(sys.modules, "gcnd.denoise")
    module = importlib.import_module("gcnd.denoise")
    assert gcnd.denoise is module.denoise
    assert gcnd.denoise is not denoise
    with pytest.raises(AttributeError, match="module 'gcnd' has no attribute 'denoised'"):
        gcnd.denoised  # noqa: B018


# --- options and progress ----------------------------------------------------------------------------


def test_no_vertex_iterations_move_nothing(preset: str) -> None:
    moved, _ = denoise((VERTICES, FACES), preset=preset, vertex_iterations=0)
    assert np.abs(moved - VERTICES).max() < 1e-14


def test_iterations_replace_those_of_the_preset() -> None:
    def denoised(config: CascadeConfig, **options: Any) -> NDArray[np.float64]:
        return denoise_arrays(VERTICES, FACES, random_cascade(config), **options)

    plain = replace(CONFIG, refinement=RefinementConfig(6, 0.3, None), vertex_iterations=3)
    found = denoised(CONFIG, normal_iterations=6, vertex_iterations=3)
    assert np.array_equal(found, denoised(plain))
    assert not np.array_equal(found, denoised(CONFIG, vertex_iterations=3))
    assert not np.array_equal(found, denoised(CONFIG, normal_iterations=6))


def test_progress_goes_up_to_one(preset: str) -> None:
    calls: list[tuple[float, str]] = []
    denoise((VERTICES, FACES), preset=preset, progress=lambda *call: calls.append(call))
    fractions = [fraction for fraction, _ in calls]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert calls[-1] == (1.0, "done")
    assert list(dict.fromkeys(label for _, label in calls)) == [
        "reading",
        "adjacency",
        "normals, pass 1 of 3",
        "vertices, pass 1 of 3",
        "normals, pass 2 of 3",
        "vertices, pass 2 of 3",
        "normals, pass 3 of 3",
        "vertices, pass 3 of 3",
        "finishing",
        "done",
    ]
    assert any(0 < fraction < 1 / 3 for fraction in fractions)


# --- errors ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (SQUARE, [[0, 1, 2], [0, 9, 3]], "face 1 refers to vertex 9, and the mesh has 4"),
        (SQUARE, [[0, 1, -1]], "face 0 refers to vertex -1"),
        (np.where(SQUARE == 0.1, np.nan, SQUARE), [[0, 1, 2]], "vertex 1 is not finite"),
        (np.where(SQUARE == 0.1, np.inf, SQUARE), [[0, 1, 2]], "vertex 1 is not finite"),
        (SQUARE, np.zeros((0, 3), int), "no faces"),
        (SQUARE, [[0, 1, 2, 3]], "face 0"),
        (SQUARE[:, :2], [[0, 1, 2]], r"vertices have shape \(4, 2\)"),
        (SQUARE, [[0.0, 1.0, 2.0]], "not integers"),
    ],
)
def test_a_mesh_that_cannot_be_worked_on(preset: str, vertices: Any, faces: Any, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        denoise((vertices, np.array(faces)), preset=preset)


def test_other_things_that_are_no_mesh(preset: str, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="cannot take a mesh from"):
        denoise(3, preset=preset)
    with pytest.raises(MeshError, match="no such file"):
        denoise(tmp_path / "none.ply", preset=preset)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"normal_iterations": -1}, "normal_iterations is -1, allowed: 0 or more"),
        ({"vertex_iterations": -2}, "vertex_iterations is -2, allowed: 0 or more"),
        ({"vertex_iterations": 10**9}, "vertex_iterations is 1000000000, allowed: 0 to 10000"),
        ({"seed": "1"}, "seed is '1', allowed: a whole number"),
        ({"seed": 1.5}, "seed is 1.5, allowed: a whole number"),
        ({"preserve_volume": "no"}, "preserve_volume is 'no', allowed: True or False"),
        ({"preset": "papers"}, "unknown preset 'papers'"),
        ({"device": "gpu7"}, "unknown device 'gpu7'"),
    ],
)
def test_a_parameter_out_of_range(preset: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        denoise((SQUARE, np.array([[0, 1, 2]])), **{"preset": preset, **options})
