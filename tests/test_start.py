"""Where the work starts: neither a spike nor a vertex that no face uses takes digits away from the others."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import gcnd
from gcnd import _geom
from gcnd.auto import read_signs
from gcnd.data.noise import add_noise
from gcnd.data.shapes import make_shape
from gcnd.filters import apply_filter
from gcnd.metrics import normal_error
from gcnd.report import noise_level
from gcnd.scans import simulate
from gcnd.start import Start
from sheet_cases import even_sheet

FAR = [1e8, 1e16, 1e38, 1e120]

CLEAN, FACES = even_sheet(20)
NOISY = add_noise(CLEAN, FACES, level=0.2, seed=1)
MIDDLE = 220


def topology_of(vertices: NDArray[np.float64], faces: NDArray[np.uint32] = FACES) -> _geom.Topology:
    return _geom.Topology(faces, len(vertices))


def with_spike(height: float) -> NDArray[np.float64]:
    spiked = NOISY.copy()
    spiked[MIDDLE, 2] = height
    return spiked


def with_stray(distance: float) -> NDArray[np.float64]:
    return np.concatenate([NOISY, [[distance, -distance, 0.5 * distance]]])


@pytest.mark.parametrize("far", FAR)
def test_a_spike_takes_no_digits_from_the_others(far: float) -> None:
    found = gcnd.denoise((with_spike(far), FACES), preset="fast")[0]
    undisturbed = normal_error(gcnd.denoise((NOISY, FACES), preset="fast")[0], CLEAN, FACES)
    assert normal_error(found, CLEAN, FACES) < undisturbed + 0.3 < 1.5
    assert abs(found[MIDDLE, 2]) < 0.5


@pytest.mark.parametrize("far", FAR)
def test_a_vertex_that_no_face_uses_changes_nothing(far: float) -> None:
    alone = gcnd.denoise((NOISY, FACES), preset="fast")[0]
    found = gcnd.denoise((with_stray(far), FACES), preset="fast")[0]
    assert np.array_equal(found[:-1], alone)
    assert np.array_equal(found[-1], with_stray(far)[-1])


def test_nor_does_it_in_a_filter() -> None:
    alone = apply_filter((NOISY, FACES), "bilateral-normal")[0]
    found = apply_filter((with_stray(1e38), FACES), "bilateral-normal")[0]
    np.testing.assert_allclose(found[:-1], alone, atol=1e-9)
    assert np.array_equal(found[-1], with_stray(1e38)[-1])


def test_what_does_not_move_keeps_its_bits() -> None:
    vertices = with_spike(3e7) + 1e5
    start = Start(topology_of(vertices), vertices)
    moved = start.positions.copy()
    moved[3] += 0.25
    back = start.way_back(moved)
    assert (np.delete(back, 3, axis=0) == np.delete(vertices, 3, axis=0)).all()
    np.testing.assert_allclose(back[3], vertices[3] + 0.25, atol=1e-9)


def test_the_noise_of_a_mesh_is_told_without_its_spikes() -> None:
    level = noise_level(topology_of(NOISY), NOISY, FACES)
    assert noise_level(topology_of(NOISY), with_spike(1e6), FACES) == pytest.approx(level, rel=0.05)
    assert noise_level(topology_of(with_stray(1e20)), with_stray(1e20), FACES) == pytest.approx(
        level, rel=1e-6
    )


def test_signs_of_a_scanner_are_seen_beside_a_spike() -> None:
    ball = make_shape(3, "smooth")
    pair = simulate("kinect2", ball.vertices, ball.faces, seed=1)
    vertices = pair.noisy_vertices.copy()
    topology = topology_of(vertices, pair.faces)
    expected = read_signs(topology, Start(topology, vertices).positions, pair.faces)
    n_faces_at = np.diff(topology.vertex_faces()[0])
    inner = int(np.flatnonzero(n_faces_at == 6)[100])
    vertices[inner] *= 1e6
    found = read_signs(topology, Start(topology, vertices).positions, pair.faces)
    assert expected.pixel_share > 0.4
    assert found.pixel_share == pytest.approx(expected.pixel_share, abs=0.01)
    assert found.level == pytest.approx(expected.level, rel=0.02)


@pytest.mark.parametrize("doublings", [-1000, -520, -300, -120, 120, 260, 300, 340, 480])
def test_however_small_or_large_a_mesh_is_it_is_denoised_alike(doublings: int) -> None:
    """Fourth powers of lengths are no numbers from 10⁻⁸⁰ down and 10⁷⁷ up, squares from 10⁻¹⁶⁰ and 10¹⁵⁴."""
    expected = gcnd.denoise((NOISY, FACES), preset="fast")[0]
    found = gcnd.denoise((np.ldexp(NOISY, doublings), FACES), preset="fast")[0]
    np.testing.assert_allclose(np.ldexp(found, -doublings), expected, atol=1e-6)


def test_ordinary_meshes_keep_their_unit_and_filters_every_mesh() -> None:
    for scale in (1.0, 1e-12, 1e12):
        vertices = scale * NOISY
        positions = Start(topology_of(vertices), vertices).positions
        assert np.array_equal(positions, vertices - vertices.mean(axis=0))
    vertices = 1e-60 * NOISY
    small = Start(topology_of(vertices), vertices, takes_spikes_off=False)
    assert np.array_equal(small.positions, vertices - vertices.mean(axis=0))
    enlarged = Start(topology_of(vertices), vertices)
    assert 0.5 <= np.abs(enlarged.positions).max() <= 1.0
    assert np.array_equal(enlarged.way_back(enlarged.positions), vertices)
