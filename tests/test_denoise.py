"""The whole line as a function: kinds of mesh, determinism, options, progress; meshes are in test_denoise_meshes.py."""

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

import gcnd
from denoise_cases import (
    CONFIG,
    EDGE,
    FACES,
    SQUARE,
    VERTICES,
    Arrays,
    noisy_sphere,
    random_cascade,
)
from gcnd import _geom, denoise, passes, predict
from gcnd.denoise import denoise_arrays
from gcnd.errors import ConfigError, MeshError
from gcnd.mesh_io import save
from gcnd.nn.cascade import CascadeConfig, RefinementConfig

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


@pytest.mark.parametrize(("fits", "iterations"), [(False, 15), (True, 15), (True, 0)])
def test_vertices_are_fitted_once_after_the_last_update_where_the_weights_say_so(
    fits: bool, iterations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = denoise_arrays(VERTICES, FACES, random_cascade(), vertex_iterations=iterations, boundary="fixed")
    given: list[Any] = []

    def fitted(_: _geom.Topology, vertices: Any, normals: Any, first: Any, boundary: str, **rest: Any) -> Any:
        given.append((vertices, len(normals), first, boundary, rest["pull"]))
        return vertices + 1.0

    monkeypatch.setattr(_geom, "fit_vertices", fitted)
    cascade = random_cascade(replace(CONFIG, pull=0.3 if fits else None))
    moved = denoise_arrays(VERTICES, FACES, cascade, vertex_iterations=iterations, boundary="fixed")
    if not (fits and iterations):
        assert not given
        assert np.array_equal(moved, plain)
        return
    ((vertices, n_normals, first, boundary, pull),) = given
    assert (n_normals, boundary, pull) == (len(FACES), "fixed", 0.3)
    np.testing.assert_allclose(moved, plain + 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(vertices - first, plain - VERTICES, rtol=0, atol=1e-12)


def labels_of(vertices: Any, faces: Any, cascade: Any) -> list[str]:
    """What a run tells that it is doing, and that its progress never goes back."""
    calls: list[tuple[float, str]] = []
    denoise_arrays(vertices, faces, cascade, progress=lambda *call: calls.append(call))
    fractions = [fraction for fraction, _ in calls]
    assert fractions == sorted(fractions)
    return list(dict.fromkeys(label for _, label in calls if "pass" in label))


@pytest.mark.parametrize("n_more", [0, 1, 2])
def test_a_flat_mesh_gets_passes_more(n_more: int) -> None:
    part = trimesh.creation.box().subdivide().subdivide()
    vertices, faces = np.array(part.vertices), part.faces.astype(np.uint32)
    cascade = random_cascade(replace(CONFIG, flat_passes=n_more))
    # The networks leave normals as they are, and so every vertex: it stays the box that it was.
    for network in cascade.stages:
        torch.nn.init.zeros_(network.out.weight)
    steps = [(kind, number) for number in (1, 2, 3) for kind in ("normals", "vertices")]
    told = labels_of(vertices, faces, cascade)
    assert told[:4] == [f"{kind}, pass {number} of 3" for kind, number in steps[:4]]
    n = 3 + n_more
    rest = [f"{kind}, pass {number} of {n}" for number in range(3, n + 1) for kind in ("normals", "vertices")]
    assert told[4:] == rest
    # A ball has no plane.
    bent = random_cascade(replace(CONFIG, flat_passes=n_more))
    assert labels_of(VERTICES, FACES, bent)[-1] == "vertices, pass 3 of 3"


def test_passes_more_come_before_the_last_with_the_coverage_of_the_early_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(passes, "is_flat", lambda *_: True)
    seen: list[float | None] = []
    predict = passes.predict_normals

    def noted(topology: Any, vertices: Any, stage: Any, *rest: Any, **options: Any) -> Any:
        seen.append(stage.coverage)
        return predict(topology, vertices, stage, *rest, **options)

    monkeypatch.setattr(passes, "predict_normals", noted)
    first = replace(CONFIG.stages[0], passes=1)
    later = replace(CONFIG.stages[0], passes=2, coverage=0.9, early_coverage=0.4)
    denoise_arrays(VERTICES, FACES, random_cascade(replace(CONFIG, stages=(first, later), flat_passes=2)))
    assert seen == [first.coverage, 0.4, 0.4, 0.4, 0.9]


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
        (
            {"preset": "papers"},
            "unknown preset 'papers', allowed: auto, default, fast, paper, paper-scan, scan or the path",
        ),
        ({"device": "gpu7"}, "unknown device 'gpu7'"),
    ],
)
def test_a_parameter_out_of_range(preset: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        denoise((SQUARE, np.array([[0, 1, 2]])), **{"preset": preset, **options})
