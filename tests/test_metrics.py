"""E_a and E_v for people: figures by hand, and input that must not slip through."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from gcnd import ConfigError, MeshError, normal_error, vertex_error
from gcnd.metrics import normal_angles

VERTICES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]])
FACES = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4]])
"""Two faces in the plane, and one without area."""

UPRIGHT = VERTICES[:, [0, 2, 1]]


def test_angles_by_hand() -> None:
    folded = VERTICES.copy()
    folded[0, 2] = np.sqrt(0.5)  # as far above the plane as from the fold: 45 degrees
    assert normal_angles(folded, VERTICES, FACES)[:2] == pytest.approx([45.0, 0.0], abs=1e-12)
    assert np.isnan(normal_angles(folded, VERTICES, FACES)[2])
    assert normal_angles(VERTICES[[0, 0, 2, 3, 4]], VERTICES, FACES[:1]).tolist() == [90.0]
    assert normal_error(folded, VERTICES, FACES) == pytest.approx(22.5)
    assert normal_error(UPRIGHT, VERTICES, FACES) == pytest.approx(90.0)
    assert np.isnan(normal_error(VERTICES, VERTICES, FACES[2:]))


def test_tensors_and_lists_are_taken() -> None:
    tensor = torch.tensor(UPRIGHT, requires_grad=True)
    assert normal_error(tensor, VERTICES.tolist(), FACES.tolist()) == pytest.approx(90.0)
    assert tensor.detach().numpy().tolist() == UPRIGHT.tolist()


def test_a_lifted_surface_is_as_far_as_it_was_lifted() -> None:
    lifted = VERTICES + np.array([0, 0, 0.5])
    error = vertex_error(lifted, FACES[:2], VERTICES, FACES[:2], samples=20_000)
    assert error * np.sqrt(2) == pytest.approx(0.5, rel=1e-3)
    assert error == vertex_error(lifted, FACES[:2], VERTICES, FACES[:2], samples=20_000, seed=0)
    assert error != vertex_error(lifted, FACES[:2], VERTICES, FACES[:2], samples=20_000, seed=1)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        # Cut to 32 bits these would be the vertices 0 and 4294967295.
        (VERTICES, [[0, 1, 2**32]], "face 0 refers to vertex 4294967296"),
        (VERTICES, [[0, 1, 2], [0, 1, -1]], "face 1 refers to vertex -1"),
        (VERTICES, [[0.0, 1.5, 2.0]], "not integers"),
        (VERTICES * np.nan, FACES, "vertex 0 is not finite"),
        (VERTICES[:, :2], FACES, "vertices have shape"),
        (VERTICES, np.zeros((0, 3), int), "no faces"),
    ],
)
def test_a_mesh_without_an_error(vertices: Any, faces: Any, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        normal_error(vertices, VERTICES, faces)
    with pytest.raises(MeshError, match=message):
        vertex_error(VERTICES, FACES, vertices, faces, samples=10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed is -1, allowed: 0 or more"),
        ({"seed": 2**64}, "seed is 18446744073709551616, allowed: below 2"),
        ({"samples": -5}, "samples is -5, allowed: 0 or more"),
        ({"samples": 0}, "samples is 0"),
    ],
)
def test_parameters_out_of_range(options: dict[str, int], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        vertex_error(VERTICES, FACES, VERTICES, FACES, **options)
