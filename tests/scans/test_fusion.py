"""Fused frames: the field on a plane, where it is known, specks, and a truth without folds."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import trimesh
from scan_cases import ball, plane_view, some_of, turned

from gcnd import _geom
from gcnd.errors import GcndError, MeshError, MeshWarning
from gcnd.scans import truth
from gcnd.scans.camera import Camera, Pose
from gcnd.scans.closest import Surface
from gcnd.scans.frame import ScanPair
from gcnd.scans.fusion import Fusion, _without_specks, fused_pair, orbit
from gcnd.scans.kinect1 import Kinect1
from gcnd.scans.sides import Sides
from gcnd.scans.truth import is_folded, project_truth
from gcnd.scans.volume import Volume

HERE = Pose(np.eye(3), np.zeros(3))
CAMERA = Camera.centered(200, 160, 300.0)


def test_one_exact_frame_of_a_plane_gives_the_plane_back() -> None:
    view = plane_view(CAMERA, 1.0, 0.4)
    volume = Volume(view.points.reshape(-1, 3), 0.01, 0.04)
    volume.add(view.depth, CAMERA, HERE)
    vertices, faces = volume.extract()
    assert len(faces) > 3000
    off = vertices @ np.array([np.sin(0.4), 0, -np.cos(0.4)]) + np.cos(0.4)
    # The depth of the nearest pixel is taken, up to half a pixel of 1/300 off, on a slope of 0.42.
    assert np.abs(off).max() < 0.5 / 300 * 1.3
    normals = _geom.face_geometry(vertices, faces)[0]
    assert (normals @ np.array([np.sin(0.4), 0, -np.cos(0.4)])).mean() > 0.95


def test_the_field_is_the_mean_of_frames() -> None:
    view = plane_view(CAMERA, 1.0, 0.0)
    volume = Volume(view.points.reshape(-1, 3), 0.01, 0.05)
    for shift in (-0.01, 0.0, 0.016):
        volume.add(view.depth + shift, CAMERA, HERE)
    vertices, _ = volume.extract()
    np.testing.assert_allclose(vertices[:, 2], 1.002, atol=1e-9)


def test_what_no_frame_sees_stays_open() -> None:
    view = plane_view(CAMERA, 1.0, 0.0)
    hole = np.array(view.depth)
    hole[60:100, 80:120] = np.nan
    volume = Volume(view.points.reshape(-1, 3), 0.01, 0.04)
    volume.add(hole, CAMERA, HERE)
    vertices, _ = volume.extract()
    u, v = CAMERA.project(vertices)
    assert not ((u > 80) & (u < 119) & (v > 60) & (v < 99)).any()
    assert ((u > 60) & (u < 140) & (v > 40) & (v < 120)).sum() > 200


def test_voxels_far_behind_are_not_written() -> None:
    view = plane_view(CAMERA, 1.0, 0.0)
    volume = Volume(view.points.reshape(-1, 3), 0.01, 0.03)
    volume.add(view.depth, CAMERA, HERE)
    behind = volume.centers[:, 2] > 1.03 + 1e-9
    assert behind.any()
    assert not volume.count[behind].any()
    before = volume.centers[:, 2] < 1.03 - 1e-9
    in_view = np.abs(volume.centers[:, :2]).max(axis=1) < 0.2
    assert (volume.count[before & in_view] == 1).all()


def test_a_volume_without_a_surface_is_empty() -> None:
    view = plane_view(CAMERA, 1.0, 0.0)
    volume = Volume(view.points.reshape(-1, 3), 0.01, 0.03)
    vertices, faces = volume.extract()
    assert (vertices.shape, faces.shape) == ((0, 3), (0, 3))


def test_missing_scikit_image_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    with pytest.raises(GcndError, match="fused scans need scikit-image") as caught:
        Volume(np.zeros((1, 3)), 0.01, 0.03).extract()
    assert "gcnd[scan]" in str(caught.value.hint)


@pytest.fixture(scope="module")
def fused() -> ScanPair:
    vertices, faces = ball(4)
    return fused_pair(vertices * 0.12, faces, 0.8, Fusion(n_frames=6), np.random.default_rng(3))


def test_the_truth_lies_on_the_surface_and_faces_outward(fused: ScanPair) -> None:
    vertices, faces = ball(4)
    found = Surface(vertices * 0.12, faces).nearest(fused.clean_vertices)
    assert np.linalg.norm(found.points - fused.clean_vertices, axis=1).max() < 1e-9 * 0.12
    normals, centers, _ = _geom.face_geometry(fused.clean_vertices, fused.faces)
    # Three points of a ball nearly in line make a face of any slope; but there are few, and none is turned over.
    outward = np.einsum("fx,fx->f", normals, centers) / 0.12
    assert (outward > 0).all()
    assert (outward > 0.95).mean() > 0.995
    assert 2000 < len(fused.faces) < 40_000


def test_the_fused_surface_is_noisy_by_about_a_millimetre(fused: ScanPair) -> None:
    off = np.linalg.norm(fused.noisy_vertices, axis=1) - 0.12
    assert 0.0003 < off.std() < 0.003
    noisy = _geom.face_geometry(fused.noisy_vertices, fused.faces)[0]
    clean = _geom.face_geometry(fused.clean_vertices, fused.faces)[0]
    assert 5 < np.nanmean(_geom.normal_angles(noisy, clean)) < 25


def test_without_noise_and_error_fusion_is_near_the_surface() -> None:
    vertices, faces = ball(4)
    exact = Fusion(Kinect1(noise=0.0, steps_per_pixel=1e9), n_frames=6, turn_error=0.0, shift_error=0.0)
    pair = fused_pair(vertices * 0.12, faces, 0.8, exact, np.random.default_rng(3))
    off = np.linalg.norm(pair.noisy_vertices, axis=1) - 0.12
    assert np.median(np.abs(off)) < 0.0003


def test_an_object_out_of_reach_gives_nothing() -> None:
    vertices, faces = ball(2)
    blind = Fusion(Kinect1(nearest=5.0))
    pair = fused_pair(vertices * 0.12, faces, 0.8, blind, np.random.default_rng(0))
    assert [len(part) for part in pair] == [0, 0, 0]


def test_an_orbit_keeps_its_distance_and_elevations() -> None:
    fusion = Fusion(n_frames=9)
    poses = orbit(np.ones(3), 0.7, fusion, np.random.default_rng(2))
    away = np.array([pose.position - 1 for pose in poses])
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.7)
    for pose in poses:
        np.testing.assert_allclose(pose.to_camera(np.ones(3)), [0, 0, 0.7], atol=1e-12)
    # All directions lie within 55° of one great circle: none is near the axis that is normal to it.
    axis = np.linalg.svd(away - away.mean(axis=0))[2][2]
    assert np.abs(away @ axis).max() <= 0.7 * np.sin(np.deg2rad(75))


def test_specks_are_left_out() -> None:
    vertices, faces = ball(2)
    speck, specks = ball(0)
    both = np.concatenate([vertices, speck * 0.1 + 3])
    kept, ids = _without_specks(both, np.concatenate([faces, specks + len(vertices)]).astype(np.uint32), 21)
    assert np.array_equal(kept, vertices)
    assert np.array_equal(ids, faces)
    assert len(_without_specks(both, np.asarray(specks + len(vertices), np.uint32), 20)[1]) == 20


def test_folds_are_smoothed_out() -> None:
    """Two vertices of a fine ball swapped: their nearest points fold the faces around them."""
    vertices, faces = ball(3)
    noisy = 1.02 * vertices
    noisy[[5, int(faces[(faces == 5).any(axis=1)][0].max())]] = noisy[
        [int(faces[(faces == 5).any(axis=1)][0].max()), 5]
    ]
    surface = Surface(vertices, faces)
    normals = _geom.face_geometry(vertices, faces)[0]
    projected, hit = surface.nearest(noisy)
    assert is_folded(projected, faces, normals[hit]).sum() >= 2
    truth, folded = project_truth(noisy, faces, vertices, faces)
    assert not folded.any()
    far = np.linalg.norm(noisy - 1.02 * vertices, axis=1) == 0
    same = np.linalg.norm(truth - projected, axis=1) < 1e-12
    assert same[far].mean() > 0.95
    assert np.linalg.norm(surface.nearest(truth).points - truth, axis=1).max() < 1e-12


FEW = Fusion(n_frames=6)


def box() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.box(extents=(1.0, 1.4, 0.7))
    return np.array(mesh.vertices), mesh.faces.astype(np.uint32)


def shell() -> tuple[np.ndarray, np.ndarray]:
    """Walls so thin that nearest points lie on the inner one."""
    vertices, faces = ball(3)
    both = np.concatenate([vertices, 0.98 * vertices])
    return both, np.concatenate([faces, turned(faces) + len(vertices)]).astype(np.uint32)


def fuse(vertices: np.ndarray, faces: np.ndarray) -> ScanPair:
    return fused_pair(vertices * 0.12, faces, 0.8, FEW, np.random.default_rng(3))


@pytest.mark.parametrize("mesh", [ball(3), box(), shell()])
def test_a_mesh_in_order_is_taken_as_it_is(
    mesh: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit for bit what comes of believing the order of corners: other bits would be other training data."""
    pair = fuse(*mesh)

    def believed(vertices: np.ndarray, faces: np.ndarray) -> Sides:
        return Sides(_geom.face_geometry(vertices, faces)[0], np.ones(len(faces), bool))

    monkeypatch.setattr(truth, "find_sides", believed)
    for own, other in zip(pair, fuse(*mesh), strict=True):
        assert np.array_equal(own, other)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_the_order_of_corners_does_not_matter(fused: ScanPair, share: float) -> None:
    vertices, faces = ball(4)
    for own, other in zip(fused, fuse(vertices, turned(faces, some_of(faces, share))), strict=True):
        assert own.shape == other.shape
        np.testing.assert_allclose(own, other, atol=1e-9)


def test_an_open_mesh_has_a_truth_on_both_sides() -> None:
    vertices, faces = ball(4)
    half = faces[vertices[faces].mean(axis=1)[:, 2] > 0]
    with pytest.warns(MeshWarning, match=r"\d\d% of the fused vertices") as told:
        pair = fuse(vertices, half)
    assert "more than 2 voxels off the mesh" in str(told[0].message)
    normals, centers, areas = _geom.face_geometry(pair.clean_vertices, pair.faces)
    is_outward = np.einsum("fx,fx->f", normals, centers) > 0
    assert 0.3 < is_outward.mean() < 0.7
    noisy = _geom.face_geometry(pair.noisy_vertices, pair.faces)[0]
    against = np.einsum("fx,fx->f", noisy, normals) < 0
    assert areas[against].sum() < 0.02 * areas.sum()


def test_a_truth_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = ball(3)

    def inward(vertices: np.ndarray, faces: np.ndarray) -> Sides:
        return Sides(-_geom.face_geometry(vertices, faces)[0], np.ones(len(faces), bool))

    monkeypatch.setattr(truth, "find_sides", inward)
    with pytest.raises(
        MeshError, match=r"the truth of (9\d|100)% of the fused faces is folded, allowed: 5%"
    ) as caught:
        fuse(vertices, faces)
    assert "a larger size may help" in str(caught.value.hint)
