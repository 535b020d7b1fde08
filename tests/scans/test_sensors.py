"""The two Kinects: deviations as published, steps of disparity, what is missing, what flies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_cases import plane_view

from gcnd.scans import kinect1, kinect2
from gcnd.scans.camera import Camera
from gcnd.scans.kinect1 import Kinect1, in_shadow
from gcnd.scans.kinect2 import Kinect2
from gcnd.scans.raster import View
from gcnd.scans.window import averaged_inside, correlated_field, gaussian_window, on_edges


def narrow(focal: float) -> Camera:
    """A camera of so narrow a view that depth and angle hardly change over the image."""
    return Camera.centered(400, 400, focal)


@pytest.mark.parametrize("depth", [0.6, 1.0, 2.5])
@pytest.mark.parametrize("tilt", [0.0, 45.0])
def test_the_first_kinect_has_the_published_deviation(depth: float, tilt: float) -> None:
    """On a plane, rounding included. The window leaves some 400 · 400 / 84 independent numbers: within 6 % or so."""
    sensor = Kinect1(camera=Camera.centered(400, 400, 585.0))
    flat = plane_view(sensor.camera, depth, np.deg2rad(tilt))
    noise = sensor.measure(flat, np.random.default_rng(3)) - flat.depth
    wanted = 0.0012 + 0.0019 * (flat.depth - 0.4) ** 2
    wanted = wanted + 0.0001 / np.sqrt(flat.depth) * (flat.angles / (np.pi / 2 - flat.angles)) ** 2
    ratio = noise / wanted
    assert np.isfinite(ratio).mean() > 0.9
    assert abs(np.nanstd(ratio) - 1) < 0.08
    assert abs(np.nanmean(ratio)) < 0.15


@pytest.mark.parametrize("depth", [0.8, 1.5, 4.0])
@pytest.mark.parametrize("tilt", [0.0, 60.0])
def test_the_second_kinect_has_the_published_deviation(depth: float, tilt: float) -> None:
    camera = narrow(4000.0)
    sensor = Kinect2(camera=camera, least_albedo=1.0)
    flat = plane_view(camera, depth, np.deg2rad(tilt))
    z, angle = flat.depth, flat.angles
    wanted = 1e-3 * (1.5 - 0.5 * z + 0.3 * z**2 + 0.1 * z**1.5 * (angle / (np.pi / 2 - angle)) ** 2)
    ratio = (sensor.measure(flat, np.random.default_rng(4)) - z) / wanted
    assert abs(np.std(ratio) - 1) < 0.02
    assert abs(np.mean(ratio)) < 0.02


def test_published_values_by_hand() -> None:
    steep = np.array(np.pi / 4)
    assert kinect1.axial_deviation(np.array(1.4), steep) == pytest.approx(0.0031 + 0.0001 / np.sqrt(1.4))
    assert kinect1.lateral_deviation(np.array(0.0)) == 0.8
    assert kinect2.axial_deviation(np.array(2.0), np.array(0.0)) == pytest.approx(0.0017)
    assert kinect2.axial_deviation(np.array(4.0), steep) == pytest.approx(0.0051)


def test_faint_surfaces_are_noisier() -> None:
    flat = plane_view(narrow(4000.0), 1.0, 0.0)
    deviations = [
        np.std(Kinect2(least_albedo=albedo).measure(flat, np.random.default_rng(0)) - flat.depth)
        for albedo in (1.0, 0.1)
    ]
    assert 1.15 < deviations[1] / deviations[0] < np.sqrt(10)


def test_noise_is_scaled_by_its_factor() -> None:
    flat = plane_view(narrow(4000.0), 2.0, 0.0)
    half = Kinect2(least_albedo=1.0, noise=0.5).measure(flat, np.random.default_rng(0)) - flat.depth
    assert abs(np.std(half) / (0.5 * 0.0017) - 1) < 0.02


def test_disparity_comes_in_eighths_of_a_pixel() -> None:
    sensor = Kinect1()
    flat = plane_view(Camera.centered(400, 400, 585.0), 1.0, 0.3)
    depth = sensor.measure(flat, np.random.default_rng(0))
    eighths = 8 * 585.0 * 0.075 / depth[np.isfinite(depth)]
    np.testing.assert_allclose(eighths, np.rint(eighths), atol=1e-9)
    assert np.diff(np.unique(np.rint(eighths))).min() == 1
    # Khoshelham and Elberink 2012: steps of 2.85e-5 z² in centimetres.
    assert sensor.depth_step(np.array(1.0)) * 100 == pytest.approx(2.85e-5 * 100**2, rel=1e-3)


def test_millimetres_of_the_second_kinect() -> None:
    flat = plane_view(Camera.centered(100, 100, 366.0), 1.0, 0.3)
    depth = 1000 * Kinect2().measure(flat, np.random.default_rng(0))
    np.testing.assert_allclose(depth, np.rint(depth), atol=1e-9)


def test_noise_is_correlated_as_its_window() -> None:
    for deviation in (0.8, 2.6):
        field = correlated_field(np.random.default_rng(0), (600, 600), gaussian_window(deviation))
        assert abs(field.std() - 1) < 0.03
        beside = np.mean(field[:, 1:] * field[:, :-1]) / np.mean(field**2)
        assert beside == pytest.approx(np.exp(-1 / (4 * deviation**2)), abs=0.02)
    white = correlated_field(np.random.default_rng(0), (300, 300), gaussian_window(0.0))
    assert abs(np.mean(white[:, 1:] * white[:, :-1])) < 0.02


def step_view(near: float, far: float) -> View:
    """Two planes that face the camera: a near one in the middle columns before a far one."""
    camera = Camera.centered(120, 40, 585.0)
    depth = np.full((40, 120), far)
    depth[:, 40:80] = near
    return View(camera.rays() * depth[..., None], np.zeros((40, 120)))


def test_the_projector_leaves_a_shadow_as_wide_as_the_disparity_changes() -> None:
    view = step_view(0.8, 1.2)
    shadow = in_shadow(view.depth, 585.0 * 0.075)
    width = 585.0 * 0.075 * (1 / 0.8 - 1 / 1.2)
    assert np.array_equal(
        np.flatnonzero(shadow[0]), np.arange(80, 80 + int(np.floor(width)) + 1)[: shadow[0].sum()]
    )
    assert abs(shadow[0].sum() - width) <= 1
    assert np.array_equal(shadow, np.tile(shadow[0], (40, 1)))
    assert np.isnan(Kinect1().measure(view, np.random.default_rng(0))[shadow]).all()


def test_nothing_is_missing_inside_a_plane_that_faces_the_camera() -> None:
    flat = plane_view(Camera.centered(80, 60, 585.0), 1.0, 0.0)
    for sensor in (Kinect1(), Kinect2()):
        assert np.isfinite(sensor.measure(flat, np.random.default_rng(0))).all()


def test_edges_are_ragged_by_about_a_pixel() -> None:
    """Lateral error: the silhouette loses pixels within a few deviations of 0.8, and none further in."""
    camera = Camera.centered(120, 400, 585.0)
    depth = np.full((400, 120), np.nan)
    depth[:, 40:80] = 1.0
    view = View(camera.rays() * depth[..., None], np.where(np.isfinite(depth), 0.0, np.nan))
    missing = np.isnan(Kinect1().measure(view, np.random.default_rng(1)))[:, 40:80].mean(axis=0)
    # Moved by σ = 0.8 and rounded, a pixel n inside the edge gets outside with probability P(ε > (n + 1/2) / 0.8).
    np.testing.assert_allclose(missing[:3], [0.266, 0.030, 0.001], atol=0.05)
    np.testing.assert_allclose(missing[::-1][:3], [0.266, 0.030, 0.001], atol=0.05)
    assert not missing[5:-5].any()
    assert len(np.unique(np.isnan(Kinect1().measure(view, np.random.default_rng(1)))[:, 40])) == 2


@pytest.mark.parametrize(("degrees", "least", "most"), [(50, 0.0, 0.0), (70, 0.35, 0.65), (82, 1.0, 1.0)])
def test_grazing_light_is_lost(degrees: float, least: float, most: float) -> None:
    flat = plane_view(narrow(40_000.0), 1.0, np.deg2rad(degrees))
    sensor = replace(Kinect1(), camera=narrow(40_000.0))
    # Of no baseline there is no shadow; only the angle counts.
    missing = np.isnan(
        replace(sensor, baseline=1e-6, steps_per_pixel=1e12).measure(flat, np.random.default_rng(2))
    )
    assert least <= missing.mean() <= most


def test_what_is_too_near_is_missing() -> None:
    for sensor, near in ((Kinect1(), 0.35), (Kinect2(), 0.45)):
        flat = plane_view(Camera.centered(40, 40, 585.0), near, 0.0)
        assert np.isnan(sensor.measure(flat, np.random.default_rng(0))).all()


def test_pixels_fly_at_the_edge_of_the_near_surface_only() -> None:
    view = step_view(1.0, 1.4)
    depth = Kinect2(noise=0.0).measure(view, np.random.default_rng(0))
    moved = np.abs(depth - view.depth) > 0.002
    assert set(np.flatnonzero(moved.any(axis=0))) == {40, 79}
    flown = depth[:, [40, 79]]
    assert flown.min() >= 1.0 - 1e-9
    assert flown.max() <= 1.2 + 1e-3
    assert abs(flown.mean() - 1.1) < 0.02


def test_a_silhouette_mixes_with_the_wall() -> None:
    depth = np.full((40, 60), np.nan)
    depth[:, 20:40] = 1.0
    view = View(
        Camera.centered(60, 40, 366.0).rays() * depth[..., None], np.where(np.isfinite(depth), 0.0, np.nan)
    )
    seen = Kinect2(noise=0.0, background=0.3).measure(view, np.random.default_rng(0))
    assert 1.0 <= seen[:, 20].min() < seen[:, 20].max() <= 1.15 + 1e-3
    assert np.array_equal(seen[:, 21:39], np.ones((40, 18)))
    assert np.isnan(seen[:, :20]).all()


def test_the_window_blurs_but_not_across_jumps() -> None:
    depth = np.full((1, 40), 1.0)
    depth[0, 20:] = 2.0
    depth[0, 5] = 1.1
    depth[0, 30] = np.nan
    kernel = gaussian_window(1.0)
    mean = averaged_inside(depth, kernel, np.full((1, 40), 0.5))
    assert mean[0, 5] == pytest.approx(1 + 0.1 * kernel[3])
    assert np.array_equal(mean[0, 17:23], depth[0, 17:23])
    assert np.isnan(mean[0, 30])
    np.testing.assert_allclose(mean[0, 31:], 2.0)


def test_edges() -> None:
    depth = np.array([[1.0, 1, 1, 1], [1, 1, 1, 3], [1, 1, 1, np.nan]])
    assert on_edges(depth, np.full((3, 4), 0.5)).tolist() == [
        [False, False, True, True],
        [False, False, True, True],
        [False, False, True, False],
    ]
