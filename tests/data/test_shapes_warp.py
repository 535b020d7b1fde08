"""Stretching and bending: how far shapes are drawn apart, and what stays."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gcnd.data.shapes_warp import MOST_STRETCHED, STEEPEST, bent, stretched

BALL = trimesh.creation.icosphere(subdivisions=3)


@given(st.integers(0, 2**32), st.floats(1e-3, 1e3))
def test_a_stretched_ball_is_an_ellipsoid_within_bounds(seed: int, size: float) -> None:
    points = stretched(BALL.vertices * size, np.random.default_rng(seed)) / size
    half_axes = np.linalg.svd(np.linalg.lstsq(BALL.vertices, points)[0], compute_uv=False)
    assert half_axes.max() <= MOST_STRETCHED + 1e-9
    assert half_axes.min() >= 1 / MOST_STRETCHED - 1e-9
    assert half_axes.max() / half_axes.min() > 1
    straight = BALL.vertices @ np.linalg.lstsq(BALL.vertices, points)[0]
    assert np.abs(straight - points).max() < 1e-9


@given(st.integers(0, 2**32), st.floats(1e-3, 1e3), st.floats(-10, 10))
def test_bending_is_no_steeper_than_it_says_and_turns_nothing_inside_out(
    seed: int, size: float, offset: float
) -> None:
    vertices = (BALL.vertices + offset) * size
    points = bent(vertices, np.random.default_rng(seed))
    ends = BALL.edges_unique
    before = vertices[ends[:, 0]] - vertices[ends[:, 1]]
    after = points[ends[:, 0]] - points[ends[:, 1]]
    assert np.all(
        np.linalg.norm(after - before, axis=1) <= STEEPEST * np.linalg.norm(before, axis=1) + 1e-9 * size
    )
    assert trimesh.Trimesh(points, BALL.faces, process=False).volume > 0


def test_bending_leaves_no_plane_and_no_ellipsoid() -> None:
    points = bent(BALL.vertices, np.random.default_rng(1))
    affine = np.column_stack([BALL.vertices, np.ones(len(points))])
    straight = affine @ np.linalg.lstsq(affine, points)[0]
    assert np.abs(straight - points).max() > 0.01


@pytest.mark.parametrize("warp", [stretched, bent])
def test_another_draw_is_another_shape_and_the_same_draw_the_same(warp) -> None:
    first, second, again = (warp(BALL.vertices, np.random.default_rng(seed)) for seed in (1, 2, 1))
    assert np.array_equal(first, again)
    assert np.abs(first - second).max() > 0.01


def test_detail_is_carried_along() -> None:
    fine = BALL.vertices * (1 + 0.02 * np.sin(40 * BALL.vertices[:, :1]))
    gap = bent(fine, np.random.default_rng(3)) - bent(BALL.vertices, np.random.default_rng(3))
    kept = np.linalg.norm(gap, axis=1) / np.maximum(np.linalg.norm(fine - BALL.vertices, axis=1), 1e-12)
    moved = np.linalg.norm(fine - BALL.vertices, axis=1) > 0.005
    assert 1 - STEEPEST < kept[moved].min() <= kept[moved].max() < 1 + STEEPEST
