"""Pairs of every kind: what holds for each, and every way to ask wrongly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scan_cases import ball, square

from gcnd import _geom
from gcnd.errors import ConfigError, MeshError
from gcnd.scans import SCAN_KINDS, Fusion, Kinect1, Kinect2, Print, ScanKind, ScanPair, simulate
from gcnd.scans.closest import Surface

SMALL_FUSION = Fusion(n_frames=5, voxel=0.006)
FRONT = np.array([0.0, 0.0, 1.0])


def scan(kind: ScanKind, seed: int = 0, **options: Any) -> ScanPair:
    if kind == "fusion":
        options.setdefault("setting", SMALL_FUSION)
    return simulate(kind, *ball(), seed=seed, **options)


def e_a(pair: ScanPair) -> float:
    noisy, clean = (_geom.face_geometry(v, pair.faces)[0] for v in (pair.noisy_vertices, pair.clean_vertices))
    return float(np.nanmean(_geom.normal_angles(noisy, clean)))


@pytest.mark.parametrize("kind", SCAN_KINDS)
def test_what_every_pair_is(kind: ScanKind) -> None:
    pair = scan(kind)
    n_vertices = len(pair.clean_vertices)
    assert pair.noisy_vertices.shape == pair.clean_vertices.shape == (n_vertices, 3)
    assert (pair.noisy_vertices.dtype, pair.faces.dtype) == (np.float64, np.uint32)
    assert np.array_equal(np.unique(pair.faces), np.arange(n_vertices))
    on_surface = Surface(*ball()).nearest(pair.clean_vertices).points
    assert np.abs(on_surface - pair.clean_vertices).max() < 1e-9
    assert 3 < e_a(pair) < 40
    # Outward, as the clean mesh is.
    normals, centers, _ = _geom.face_geometry(pair.clean_vertices, pair.faces)
    assert (np.einsum("fx,fx->f", normals, centers) > 0).mean() > 0.999


@pytest.mark.parametrize("kind", SCAN_KINDS)
def test_the_seed_decides(kind: ScanKind) -> None:
    first, again, other = scan(kind, 4), scan(kind, 4), scan(kind, 5)
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a, b)
    assert first.noisy_vertices.shape != other.noisy_vertices.shape or not np.array_equal(
        first.noisy_vertices, other.noisy_vertices
    )


@pytest.mark.parametrize("kind", ["kinect1", "kinect2", "print"])
def test_a_pair_does_not_depend_on_unit_and_place(kind: ScanKind) -> None:
    vertices, faces = ball()
    near = simulate(kind, vertices, faces, view=None if kind == "print" else FRONT)
    far = simulate(kind, 1000 * vertices + 5000, faces, view=None if kind == "print" else FRONT)
    if kind == "print":  # its waves run through space
        assert e_a(far) == pytest.approx(e_a(near), rel=0.2)
        return
    assert np.array_equal(near.faces, far.faces)
    np.testing.assert_allclose(far.noisy_vertices, 1000 * near.noisy_vertices + 5000, atol=1e-6)


@pytest.mark.parametrize("kind", ["kinect1", "print"])
@pytest.mark.parametrize("doublings", [-900, 480])
def test_no_size_is_too_small_or_too_large(kind: ScanKind, doublings: int) -> None:
    vertices, faces = ball(2)
    view = None if kind == "print" else FRONT
    usual = simulate(kind, vertices, faces, view=view)
    stray = np.append(np.ldexp(vertices, doublings), [[1.5, -1e140, 0.0]], axis=0)
    sized = simulate(kind, stray, faces, view=view)
    assert np.array_equal(sized.faces, usual.faces)
    if kind == "print":
        assert np.array_equal(sized.noisy_vertices[-1], stray[-1])
        # Nothing that is far away widens its waves.
        sized = sized._replace(
            noisy_vertices=sized.noisy_vertices[:-1], clean_vertices=sized.clean_vertices[:-1]
        )
        wide = np.append(vertices, [[0.0, 0, 0]], axis=0)
        usual = ScanPair(simulate(kind, wide, faces).noisy_vertices[:-1], vertices, faces)
    for one, other in zip(sized[:2], usual[:2], strict=True):
        np.testing.assert_allclose(np.ldexp(one, -doublings), other, rtol=1e-12, atol=1e-14)


def test_a_frame_sees_one_side_from_its_view() -> None:
    pair = scan("kinect2", view=FRONT)
    assert pair.clean_vertices[:, 2].min() > 0
    assert pair.clean_vertices[:, 2].max() > 0.99
    # Noise is along the line of sight, which meets in the camera: 1.2 m away, where a ball of 2√3 is 0.4 m long.
    camera = FRONT * 1.2 * 2 * np.sqrt(3) / 0.4
    to_clean, to_noisy = pair.clean_vertices - camera, pair.noisy_vertices - camera
    across = np.linalg.norm(np.cross(to_clean, to_noisy), axis=1) / np.linalg.norm(to_clean, axis=1)
    assert across.max() < 1e-9


def test_a_plane_that_faces_the_camera_is_whole() -> None:
    vertices, faces = square()
    pair = simulate("kinect2", vertices, faces, view=FRONT, setting=Kinect2(noise=0.0))
    side = 0.4 / np.sqrt(2) / 1.2 * 366
    # Up to a row of pixels on each side is lost to flying.
    assert 2 * (side - 4) ** 2 < len(pair.faces) < 2 * side**2
    # But for the flying pixels of its rim it is a plane, and the millimetre's rounding moves it as one.
    inner = np.abs(pair.clean_vertices[:, :2]).max(axis=1) < 0.95
    assert np.ptp(pair.noisy_vertices[inner, 2]) < 1e-9


def test_nearer_objects_have_more_and_better_faces() -> None:
    near, far = scan("kinect1", distance=0.7, view=FRONT), scan("kinect1", distance=1.4, view=FRONT)
    assert 3.4 < len(near.faces) / len(far.faces) < 4.8
    assert e_a(near) < e_a(far)
    large = scan("kinect1", size=0.6, view=FRONT)
    assert 2.0 < len(large.faces) / len(scan("kinect1", view=FRONT).faces) < 2.6


def test_surfaces_are_not_joined_across_a_jump() -> None:
    """A square before another: no triangle of the truth or of the scan between them."""
    vertices, faces = square()
    behind = vertices * 2 - [0, 0, 1]
    pair = simulate(
        "kinect1",
        np.concatenate([vertices, behind]),
        np.concatenate([faces, faces + 4]),
        view=FRONT,
        setting=Kinect1(noise=0.5),
    )
    depth = pair.clean_vertices[pair.faces][..., 2]
    assert np.ptp(depth, axis=1).max() < 1e-9
    assert (depth[:, 0] > -0.5).mean() > 0.15
    assert (depth[:, 0] < -0.5).mean() > 0.5
    assert np.ptp(pair.noisy_vertices[pair.faces][..., 2], axis=1).max() < 0.5


def test_noisier_settings_are_noisier() -> None:
    assert e_a(scan("kinect2", setting=Kinect2(noise=0.3), view=FRONT)) < e_a(scan("kinect2", view=FRONT))
    assert e_a(scan("print", setting=Print(relief=0.0))) < e_a(scan("print"))
    rough = replace(SMALL_FUSION, sensor=Kinect1(noise=3.0))
    assert e_a(scan("fusion")) < e_a(scan("fusion", setting=rough))


def test_vertices_that_a_file_repeats_move_together() -> None:
    vertices, faces = ball(2)
    apart = simulate("print", vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    corners = apart.noisy_vertices.reshape(-1, 3, 3)
    for vertex_id in range(len(vertices)):
        own = corners[faces == vertex_id]
        assert np.array_equal(own, np.tile(own[0], (len(own), 1)))


def test_unused_vertices_do_not_count_for_the_size() -> None:
    vertices, faces = ball()
    stray = np.concatenate([vertices, [[900.0, 0, 0]]])
    with_stray = simulate("kinect1", stray, faces, view=FRONT)
    assert np.array_equal(with_stray.faces, simulate("kinect1", vertices, faces, view=FRONT).faces)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "kinect3"}, r"unknown kind of scan 'kinect3'"),
        ({"size": 0.0}, r"size is 0.0, allowed: above 0 to 100 metres"),
        ({"size": float("nan")}, r"size is nan"),
        ({"size": 101.0}, r"size is 101.0"),
        ({"distance": 0.5}, r"distance is 0.5, allowed: 0.6 to 100 metres"),
        ({"distance": float("inf")}, r"distance is inf"),
        ({"kind": "fusion", "distance": 0.5}, r"distance is 0.5, allowed: 0.6 to"),
        ({"view": np.zeros(3)}, r"view is \[0.0, 0.0, 0.0\], allowed: three finite numbers, not all 0"),
        ({"view": np.ones(2)}, r"view is \[1.0, 1.0\]"),
        ({"seed": -1}, r"seed is -1, allowed: 0 or more"),
        ({"setting": Print()}, r"setting of kinect1 is a Print, allowed: Kinect1"),
        ({"setting": Kinect1(noise=-1.0)}, r"noise of kinect1 is -1.0, allowed: finite and 0 or more"),
        ({"setting": Kinect1(baseline=0.0)}, r"baseline of kinect1 is 0.0, allowed: above 0"),
        ({"kind": "kinect2", "setting": Kinect2(least_albedo=0.0)}, r"least_albedo of kinect2 is 0.0"),
        (
            {"kind": "kinect2", "setting": Kinect2(least_albedo=1.5)},
            r"least_albedo of kinect2 is 1.5, allowed: up to",
        ),
        ({"setting": Kinect1(steepest=1.57)}, r"steepest of kinect1 is 1.57, allowed: up to 1.55"),
        (
            {"kind": "fusion", "setting": Fusion(voxel=1e-6)},
            r"voxel is 1e-06: the volume would have .* allowed: 2e\+08",
        ),
        ({"kind": "fusion", "setting": Fusion(voxel=float("nan"))}, r"voxel of fusion is nan"),
        ({"kind": "fusion", "setting": Fusion(Kinect1(window=-2.0))}, r"window of fusion is -2.0"),
        ({"kind": "print", "setting": Print(layer=-1.0)}, r"layer of print is -1.0"),
    ],
)
def test_wrong_parameters_are_named(options: dict[str, Any], message: str) -> None:
    vertices, faces = ball(1)
    with pytest.raises(ConfigError, match=message):
        simulate(**{"kind": "kinect1", "vertices": vertices, "faces": faces, **options})


def test_unusable_meshes_are_told() -> None:
    vertices, _ = ball(1)
    with pytest.raises(MeshError, match="the mesh has no faces"):
        simulate("kinect1", vertices, np.zeros((0, 3), np.uint32))
    with pytest.raises(MeshError, match="all vertices lie at one point"):
        simulate("kinect1", np.zeros((3, 3)), np.array([[0, 1, 2]], np.uint32))
    with pytest.raises(MeshError, match="all vertices lie at one point"):
        simulate("print", np.ones((3, 3)), np.array([[0, 1, 2]], np.uint32))
    with pytest.raises(MeshError, match="42"):
        simulate("print", vertices, np.array([[0, 1, 42]], np.uint32))
    with pytest.raises(MeshError, match="the kinect1 scan found no surface") as caught:
        simulate("kinect1", *square(), view=np.array([1.0, 0, 0]))
    assert "another seed" in str(caught.value.hint)
