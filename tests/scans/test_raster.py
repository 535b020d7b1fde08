"""The depth buffer against rays cast one by one."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gcnd.errors import MeshError
from gcnd.scans import raster
from gcnd.scans.camera import Camera, look_at
from gcnd.scans.raster import View, render

CAMERA = Camera.centered(41, 31, 50.0)


def cast(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Depth and angle at every pixel by Möller and Trumbore's test of every triangle."""
    rays = camera.rays().reshape(-1, 3)
    depth, angle = np.full(len(rays), np.inf), np.full(len(rays), np.nan)
    for a, b, c in vertices[faces]:
        normal = np.cross(b - a, c - a)
        across = np.cross(rays, c - a)
        det = across @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            beta = (across @ -a) / det
            gamma = (rays @ np.cross(-a, b - a)) / det
            t = (np.cross(-a, b - a) @ (c - a)) / det
        hit = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (t > 0) & (t < depth)
        cosine = np.abs(rays @ normal) / np.linalg.norm(rays, axis=1) / np.linalg.norm(normal)
        depth[hit], angle[hit] = t[hit], np.arccos(np.clip(cosine[hit], 0, 1))
    depth[np.isinf(depth)] = np.nan
    return depth.reshape(camera.height, -1), angle.reshape(camera.height, -1)


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray]:
    """A ball before a box: small and large triangles, one surface before another."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.37)
    box = trimesh.creation.box((1.1, 0.9, 0.5))
    box.apply_translation([0.35, 0.1, -0.7])
    both = trimesh.util.concatenate([ball, box])
    pose = look_at(np.zeros(3), np.array([0.3, 0.2, 1.0]), 2.3, 0.4)
    return pose.to_camera(np.array(both.vertices)), np.array(both.faces)


@pytest.fixture(scope="module")
def view(scene: tuple[np.ndarray, np.ndarray]) -> View:
    return render(*scene, CAMERA)


def test_depth_and_angle_are_those_of_rays(scene: tuple[np.ndarray, np.ndarray], view: View) -> None:
    depth, angle = cast(*scene, CAMERA)
    assert np.isfinite(depth).sum() > 300
    assert np.array_equal(np.isfinite(view.depth), np.isfinite(depth))
    np.testing.assert_allclose(view.depth, depth, rtol=1e-12)
    np.testing.assert_allclose(view.angles, angle, atol=1e-7)


def test_points_lie_on_their_rays(view: View) -> None:
    hit = np.isfinite(view.depth)
    np.testing.assert_allclose(view.points[hit], (CAMERA.rays() * view.depth[..., None])[hit], atol=1e-12)
    assert np.isnan(view.points[~hit]).all()


def test_pieces_drawn_one_by_one_give_the_same(
    scene: tuple[np.ndarray, np.ndarray], view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raster, "_CANDIDATES_AT_ONCE", 1)
    one_by_one = render(*scene, CAMERA)
    assert np.array_equal(one_by_one.depth, view.depth, equal_nan=True)


def test_no_crack_between_triangles_through_pixel_centres() -> None:
    """A fan whose edges run along rows, columns and diagonals of pixels."""
    camera = Camera(9, 9, 4.0, 4.0, 4.0)
    corners = [[0.0, 0, 1]] + [
        [x, y, 1.0] for x, y in ((-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0))
    ]
    faces = np.array([[0, i, i % 8 + 1] for i in range(1, 9)])
    assert np.array_equal(render(np.array(corners), faces, camera).depth, np.ones((9, 9)))


def test_a_mesh_behind_the_camera_is_told() -> None:
    with pytest.raises(MeshError, match=r"vertex 2 at depth -1.0 is not in front"):
        render(np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, -1]]), np.array([[0, 1, 2]]), CAMERA)


def test_a_triangle_seen_from_its_side_hides_nothing() -> None:
    edge_on = np.array([[0.0, 0, 1], [0, 0, 2], [0, 0, 3]])
    assert np.isnan(render(edge_on, np.array([[0, 1, 2]]), CAMERA).depth).all()
