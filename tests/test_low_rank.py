"""Non-local low-rank filtering against an independent reference, and what its parameters allow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gcnd.errors import ConfigError, GcndError
from gcnd.filters import apply_filter
from reference import low_rank as reference
from reference.meshes import cube, jittered, open_sphere

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


def meshes() -> list[Arrays]:
    vertices, faces = open_sphere(3)
    used, faces = np.unique(faces, return_inverse=True)
    return [
        (jittered(cube(3)[0], 0.02, seed=1), cube(3)[1]),
        (jittered(vertices[used], 0.02, seed=2), faces.reshape(-1, 3)),
    ]


@pytest.mark.parametrize(
    "parameters",
    [
        {"patch_size": 12, "search_rings": 3},
        {"patch_size": 20, "search_rings": 4, "similar_patches": 25, "sigma_m": 0.35, "vertex_iterations": 5},
        {"patch_size": 12, "search_rings": 2, "similar_patches": 1},
        {"patch_size": 12, "search_rings": 3, "vertex_iterations": 9, "fixed_step": True},
    ],
)
@pytest.mark.parametrize("mesh", meshes())
def test_low_rank_is_the_reference(mesh: Arrays, parameters: dict[str, Any]) -> None:
    vertices, faces = mesh
    expected = reference.denoise(vertices, faces, **parameters)
    moved, _ = apply_filter(mesh, "low-rank", **parameters)
    assert np.abs(moved - expected).max() < 1e-10
    assert np.abs(moved - vertices).max() > 0.01


def test_a_fixed_step_diverges_around_a_vertex_of_many_faces() -> None:
    angles = np.arange(40) * np.pi / 20
    vertices = np.vstack([[0.0, 0.0, 0.1], np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)])
    faces = np.array([[0, 1 + i, 1 + (i + 1) % 40] for i in range(40)])
    options = {"vertex_iterations": 20, "fix_boundary": True}
    moved, _ = apply_filter((vertices, faces), "low-rank", **options)
    assert np.abs(moved).max() <= 1.0
    with pytest.raises(GcndError, match=r"diverged in iteration \d+"):
        apply_filter((vertices, faces), "low-rank", **options, fixed_step=True)


def test_a_component_smaller_than_a_patch_is_a_patch() -> None:
    vertices, faces = cube(1)
    vertices = jittered(vertices, 0.02, seed=3)
    moved, _ = apply_filter((vertices, faces), "low-rank", patch_size=len(vertices))
    larger, _ = apply_filter((vertices, faces), "low-rank", patch_size=512)
    assert np.array_equal(moved, larger)
    assert np.abs(moved - vertices).max() > 0.005


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("sigma_m", 0.0, "a positive finite number"),
        ("sigma_m", float("inf"), "a positive finite number"),
        ("similar_patches", 0, "1 to 64"),
        ("similar_patches", 65, "1 to 64"),
        ("patch_size", 1, "2 to 512"),
        ("search_rings", 33, "1 to 32"),
        ("normal_iterations", -1, "0 or more"),
    ],
)
def test_parameters_out_of_range_name_themselves(name: str, value: float, allowed: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} is .*, allowed: {allowed}"):
        apply_filter(meshes()[0], "low-rank", **{name: value})
