"""The whole line on meshes of all sorts: what a result does not depend on, odd meshes, and those that are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray

from denoise_cases import (
    CONFIG,
    EDGE,
    EVERY_FACE,
    FACES,
    SQUARE,
    VERTICES,
    random_cascade,
)
from gcnd import denoise
from gcnd.denoise import denoise_arrays
from gcnd.errors import MeshError, MeshWarning
from gcnd.nn.cascade import Cascade

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


@pytest.mark.parametrize("name", ["the same face twice", "a face and its back"])
def test_a_repeated_face_changes_nothing(preset: str, name: str) -> None:
    vertices, faces = ODD[name]
    with pytest.warns(MeshWarning, match="1 of 3 faces repeat an earlier one"):
        moved, same = denoise((vertices, np.array(faces)), preset=preset)
    with pytest.warns(MeshWarning, match="one open piece of 2 faces"):
        once, _ = denoise((vertices, np.array([faces[0], faces[2]])), preset=preset)
    assert np.array_equal(moved, once)
    assert np.abs(moved - vertices).max() > 1e-3
    assert same.tolist() == faces


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


@pytest.mark.parametrize("kind", ["sparse", "meta"])
def test_a_tensor_without_numbers_of_its_own_is_refused(kind: str) -> None:
    tensor = torch.tensor(VERTICES).to_sparse() if kind == "sparse" else torch.tensor(VERTICES, device="meta")
    with pytest.raises(MeshError, match="vertices are a tensor that numpy cannot hold"):
        denoise((tensor, FACES), preset="fast")
