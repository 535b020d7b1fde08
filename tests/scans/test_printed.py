"""Scanned prints: each part of the noise alone."""

from __future__ import annotations

import numpy as np
import pytest
from scan_cases import ball

from gcnd import _geom
from gcnd.data.noise import mean_edge_length
from gcnd.scans.printed import Print, printed_pair

NOTHING = Print(blur_rounds=0, relief=0.0, warp=0.0, noise=0.0)


def outward(**parts: float) -> np.ndarray:
    """How far each vertex of a unit ball moves, in mean edges."""
    vertices, faces = ball(4)
    setting = Print(**{**vars(NOTHING), **parts})
    pair = printed_pair(vertices, faces, setting, np.random.default_rng(0))
    assert np.array_equal(pair.clean_vertices, vertices)
    assert np.array_equal(pair.faces, faces)
    moved = pair.noisy_vertices - vertices
    across = moved - np.einsum("vx,vx->v", moved, vertices)[:, None] * vertices
    assert np.abs(across).max() < 0.05 * max(np.abs(moved).max(), 1e-12)
    return np.einsum("vx,vx->v", moved, vertices) / mean_edge_length(vertices, faces)


def test_a_perfect_print_is_the_model() -> None:
    assert not outward().any()


@pytest.mark.parametrize("part", ["relief", "warp", "noise"])
def test_every_part_has_its_deviation(part: str) -> None:
    amount = outward(**{part: 0.2})
    # A ball of some 13 warps has few independent values of it.
    assert np.sqrt(np.mean(amount**2)) == pytest.approx(0.2, rel=0.4 if part == "warp" else 0.12)


def test_warp_is_slow_and_noise_is_not() -> None:
    _, faces = ball(4)
    start, end = faces[:, 0], faces[:, 1]
    for part, most in (("warp", 0.35), ("noise", 1.0)):
        amount = outward(**{part: 0.2, "noise_rounds": 1})
        step = np.sqrt(np.mean((amount[start] - amount[end]) ** 2)) / amount.std()
        assert (step < most) if part == "warp" else (0.5 < step < 1.4)


def test_layers_are_planes_across_one_direction() -> None:
    """The wave is a function of height but for a slow drift: along some direction nothing else explains it better."""
    vertices, faces = ball(4)
    edge = mean_edge_length(vertices, faces)
    amount = outward(relief=0.2, layer=6.0)
    rng = np.random.default_rng(0)
    up = rng.standard_normal(3)
    up /= np.linalg.norm(up)

    def explained(direction: np.ndarray) -> float:
        wave = np.exp(2j * np.pi * vertices @ direction / (6 * edge))
        # In slices of a sixth of the ball along another axis the drift is nearly one number.
        side = np.cross(direction, [0.3, 0.5, 0.8])
        slices = np.digitize(vertices @ (side / np.linalg.norm(side)), np.linspace(-1, 1, 13))
        parts = [abs(np.mean((amount * wave)[slices == s])) * np.mean(slices == s) for s in np.unique(slices)]
        return float(np.sum(parts)) / 0.2

    others = np.random.default_rng(9).standard_normal((20, 3))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    others = others[np.abs(others @ up) < 0.8]
    assert explained(up) > 2 * max(explained(other) for other in others)


def test_blur_shrinks_what_sticks_out() -> None:
    vertices, faces = ball(3)
    spike = np.array(vertices)
    spike[0] *= 1.3
    blurred = printed_pair(
        spike, faces, Print(**{**vars(NOTHING), "blur_rounds": 1}), np.random.default_rng(0)
    )
    height = np.linalg.norm(blurred.noisy_vertices[0])
    assert 1.0 < height < 1.06
    assert np.array_equal(blurred.clean_vertices, spike)


def test_defaults_are_as_noisy_as_the_papers_prints() -> None:
    """The paper's four prints are 8.1° to 18.1° off; a smooth ball is the least of it."""
    vertices, faces = ball(5)
    pair = printed_pair(vertices, faces, Print(), np.random.default_rng(0))
    noisy, clean = (_geom.face_geometry(v, faces)[0] for v in (pair.noisy_vertices, pair.clean_vertices))
    assert 6 < np.nanmean(_geom.normal_angles(noisy, clean)) < 18
