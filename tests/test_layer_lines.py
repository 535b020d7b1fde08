"""Lines of a printer's layers: waves that were put on a surface, and what is none."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from gcnd.data.noise import add_noise, mean_edge_length, vertex_normals
from gcnd.layer_lines import LayerLines, layer_lines, unevenness

Points = NDArray[np.float64]
Faces = NDArray[np.uint32]

UP = np.array([2.0, -1.0, 3.0]) / np.sqrt(14)


def ball() -> tuple[Points, Faces]:
    mesh = trimesh.creation.icosphere(subdivisions=5)
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.uint32)


def box() -> tuple[Points, Faces]:
    mesh = trimesh.creation.box((2.0, 1.5, 1.0))
    for _ in range(5):
        mesh = mesh.subdivide()
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.uint32)


def lines_of(vertices: Points, faces: Faces) -> LayerLines:
    return layer_lines(unevenness(vertices, faces), mean_edge_length(vertices, faces))


def with_wave(vertices: Points, faces: Faces, up: Points, length: float, height: float) -> Points:
    edge = mean_edge_length(vertices, faces)
    wave = height * edge * np.sin(2 * np.pi * (vertices @ up) / (length * edge))
    return vertices + wave[:, None] * vertex_normals(vertices, faces)


@pytest.mark.parametrize("length", [3.0, 4.5, 7.0])
def test_a_wave_is_found_with_its_length(length: float) -> None:
    vertices, faces = ball()
    found = lines_of(with_wave(vertices, faces, UP, length, 0.2), faces)
    assert found.wavelength == pytest.approx(length, rel=0.1)
    assert found.share > 0.3
    assert found.contrast > 50
    assert found.reach == 1.0
    assert found.weakest_side > 0.6


@pytest.mark.parametrize("level", [0.05, 0.3, 0.7])
@pytest.mark.parametrize("name", ["ball", "box"])
def test_noise_of_every_vertex_has_no_waves(name: str, level: float) -> None:
    vertices, faces = ball() if name == "ball" else box()
    found = lines_of(add_noise(vertices, faces, level=level, seed=5), faces)
    assert found.share < 0.02


def test_places_do_not_tell_of_noise_along_the_normal_of_a_plane() -> None:
    # At its noisy place, a vertex of a wall tells its offset by its phase: all vertices agree on a wave across it.
    ids = np.arange(60 * 60).reshape(60, 60)
    corner, right, below, across = (
        a.ravel() for a in (ids[:-1, :-1], ids[:-1, 1:], ids[1:, :-1], ids[1:, 1:])
    )
    faces = np.vstack([np.c_[corner, right, across], np.c_[corner, across, below]]).astype(np.uint32)
    wall = np.c_[
        np.stack(np.meshgrid(np.arange(60.0), np.arange(60.0)), axis=-1).reshape(-1, 2), np.zeros(3600)
    ]
    wall[:, 2] += 0.5 * np.random.default_rng(1).standard_normal(3600)
    found = unevenness(wall, faces)
    at_noisy_place = layer_lines(found._replace(places=wall), 1.0)
    assert at_noisy_place.share > 5 * layer_lines(found, 1.0).share
    inside = ids[1:-1, 1:-1].ravel()
    assert abs(np.corrcoef(found.offsets[inside], found.places[inside, 2])[0, 1]) < 0.05
    assert abs(np.corrcoef(found.offsets[inside], wall[inside, 2])[0, 1]) > 0.8


def test_ribs_on_some_walls_are_a_shape() -> None:
    vertices, faces = box()
    up = np.array([1.0, 0.0, 0.0])
    is_top = np.abs(vertex_normals(vertices, faces)[:, 2]) > 0.5
    ribbed = with_wave(vertices, faces, up, 4.0, 0.2)
    noise = add_noise(vertices, faces, level=0.1, seed=2) - vertices
    printed = lines_of(ribbed + noise, faces)
    ribs = lines_of(np.where(is_top[:, None], ribbed, vertices) + noise, faces)
    assert printed.weakest_side > 0.6
    assert ribs.contrast > 20
    assert ribs.weakest_side < 0.1


def test_offsets_by_hand_and_none_without_a_face() -> None:
    roof = np.array([[0.0, 0, 3], [1, 0, 0], [-1, 1, 0], [-1, -1, 0], [9, 9, 9]])
    found = unevenness(roof, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]], dtype=np.uint32))
    # The mean of its three neighbours is (−1/3, 0, 0), and the normals add up to (0, 0, 4) and what the slopes leave.
    assert found.offsets[0] == pytest.approx(found.normals[0] @ [1 / 3, 0, 3], rel=1e-12)
    assert found.offsets[4] == 0
    assert found.normals[4].tolist() == [0, 0, 0]
    assert found.places[4].tolist() == [9, 9, 9]
    assert found.places[0] == pytest.approx((2 * roof[0] + 2 * roof[1:4].sum(axis=0)) / 8)


@pytest.mark.parametrize("n", [0, 3])
def test_too_few_vertices_show_nothing(n: int) -> None:
    faces = np.array([[0, 1, 2]][: n // 3], dtype=np.uint32).reshape(-1, 3)
    assert lines_of(np.eye(3)[:n], faces) == LayerLines()


def test_vertices_strewn_beyond_all_boxes_show_nothing() -> None:
    vertices, faces = ball()
    far = np.vstack([vertices, [[1e30, 0, 0], [0, 1e30, 0], [0, 0, 1e30]]])
    assert layer_lines(unevenness(far, faces), mean_edge_length(vertices, faces)) == LayerLines()
