"""The camera: what projects where, crops, poses."""

from __future__ import annotations

import numpy as np

from gcnd.scans.camera import Camera, look_at, random_direction, rotation_from_vector


def test_rays_and_projection_are_inverse() -> None:
    camera = Camera(7, 5, 3.0, 2.5, 1.0)
    u, v = camera.project(camera.rays() * 4.2)
    np.testing.assert_allclose(u, np.tile(np.arange(7.0), (5, 1)), atol=1e-12)
    np.testing.assert_allclose(v, np.tile(np.arange(5.0)[:, None], (1, 7)), atol=1e-12)


def test_a_crop_keeps_the_pixels_of_the_whole_image() -> None:
    whole = Camera.centered(640, 480, 585.0)
    points = np.array([[-0.1, 0.05, 1.0], [0.2, -0.1, 1.5]])
    part = whole.cropped(points, 3)
    column, row = whole.center_x - part.center_x, whole.center_y - part.center_y
    assert (column, row) == (int(column), int(row))
    np.testing.assert_allclose(
        part.rays(),
        whole.rays()[int(row) : int(row) + part.height, int(column) : int(column) + part.width],
        atol=1e-15,
    )
    u, v = part.project(points)
    assert u.min() >= 3
    assert v.min() >= 3
    assert u.max() <= part.width - 1 - 3
    assert v.max() <= part.height - 1 - 3


def test_a_crop_ends_with_the_image() -> None:
    whole = Camera.centered(64, 48, 50.0)
    far_out = np.array([[-9.0, -9.0, 1.0], [9.0, 9.0, 1.0]])
    assert whole.cropped(far_out, 2) == whole
    beside = whole.cropped(np.array([[9.0, 9.0, 1.0]]), 2)
    assert (beside.width, beside.height) == (1, 1)


def test_a_camera_looks_at_its_target_and_stands_upright() -> None:
    rng = np.random.default_rng(5)
    for roll in (0.0, 0.7):
        target, direction = rng.standard_normal(3), random_direction(rng)
        pose = look_at(target, direction, 2.5, roll)
        np.testing.assert_allclose(pose.world_from_camera.T @ pose.world_from_camera, np.eye(3), atol=1e-14)
        assert abs(np.linalg.det(pose.world_from_camera) - 1) < 1e-14
        np.testing.assert_allclose(pose.to_camera(target), [0, 0, 2.5], atol=1e-14)
        above = pose.to_camera(target + np.array([0.0, 0.0, 0.1]))
        if roll == 0:
            assert abs(above[0]) < 1e-14
            assert above[1] < 0
    points = rng.standard_normal((4, 3))
    np.testing.assert_allclose(pose.to_world(pose.to_camera(points)), points, atol=1e-14)


def test_a_camera_can_look_along_the_world_axis() -> None:
    for sign in (1.0, -1.0):
        pose = look_at(np.zeros(3), np.array([0, 0, sign]), 1.0, 0.0)
        assert abs(np.linalg.det(pose.world_from_camera) - 1) < 1e-14


def test_a_rotation_vector_turns_by_its_length_around_itself() -> None:
    np.testing.assert_allclose(
        rotation_from_vector(np.array([0.0, 0, np.pi / 2])) @ [1, 0, 0], [0, 1, 0], atol=1e-15
    )
    assert np.array_equal(rotation_from_vector(np.zeros(3)), np.eye(3))


def test_a_disturbed_pose_turns_around_its_pivot() -> None:
    pivot = np.array([0.3, -0.2, 0.5])
    pose = look_at(pivot, np.array([1.0, 1, 0]), 2.0, 0.0)
    turned = pose.disturbed(np.array([0.0, 0.1, 0.0]), np.zeros(3), pivot)
    np.testing.assert_allclose(turned.to_camera(pivot), pose.to_camera(pivot), atol=1e-14)
    assert abs(np.linalg.norm(turned.position - pose.position) - 2 * 2.0 * np.sin(0.05)) > 1e-6
    shifted = pose.disturbed(np.zeros(3), np.array([0.0, 0, 0.01]), pivot)
    np.testing.assert_allclose(shifted.position - pose.position, [0, 0, 0.01], atol=1e-15)
