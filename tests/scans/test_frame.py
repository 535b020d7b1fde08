"""One frame as a pair: pixels on their rays, and a camera that stands inside the mesh."""

from __future__ import annotations

import numpy as np
import pytest
from scan_cases import ball

from gcnd.errors import MeshError
from gcnd.scans.camera import look_at
from gcnd.scans.frame import frame_pair, take_frame
from gcnd.scans.kinect1 import Kinect1
from gcnd.scans.kinect2 import Kinect2

POSE = look_at(np.zeros(3), np.array([1.0, 2.0, 0.5]), 1.0, 0.2)


@pytest.mark.parametrize("sensor", [Kinect1(), Kinect2()])
def test_the_noisy_mesh_has_the_measured_depth(sensor: Kinect1 | Kinect2) -> None:
    vertices, faces = ball(3)
    frame = take_frame(vertices * 0.2, faces, sensor, POSE, np.random.default_rng(7))
    pair = frame_pair(vertices * 0.2, faces, sensor, POSE, np.random.default_rng(7))
    local = POSE.to_camera(pair.noisy_vertices)
    columns, rows = (np.rint(value).astype(int) for value in frame.camera.project(local))
    np.testing.assert_allclose(local[:, 2], frame.depth[rows, columns], rtol=1e-12)
    exact = POSE.to_camera(pair.clean_vertices)
    np.testing.assert_allclose(exact, frame.exact.points[rows, columns], rtol=1e-9)
    for u, v in (frame.camera.project(local), frame.camera.project(exact)):
        np.testing.assert_allclose(u, columns, atol=1e-9)
        np.testing.assert_allclose(v, rows, atol=1e-9)


def test_the_part_of_the_image_does_not_change_what_is_seen() -> None:
    vertices, faces = ball(3)
    frame = take_frame(vertices * 0.2, faces, Kinect2(), POSE, np.random.default_rng(0))
    rim = np.ones(frame.depth.shape, dtype=bool)
    rim[4:-4, 4:-4] = False
    assert np.isnan(frame.exact.depth[rim]).all()


def test_a_camera_inside_the_mesh_is_told() -> None:
    vertices, faces = ball(1)
    with pytest.raises(MeshError, match=r"vertex \d+ is not in front of the camera"):
        take_frame(vertices * 2, faces, Kinect1(), POSE, np.random.default_rng(0))
