"""Preset "auto": signs of a scanner in a mesh, and the weights that they choose."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from typer.testing import CliRunner

import gcnd
from gcnd import _geom
from gcnd.auto import CANDIDATES, Signs, choose_preset, read_signs
from gcnd.cli import app
from gcnd.data.noise import NoiseKind, add_noise
from gcnd.denoiser import Denoiser
from gcnd.mesh_io import save
from gcnd.scans import Kinect1, Kinect2, ScanKind, simulate

Points = NDArray[np.float64]
Faces = NDArray[np.uint32]


def signs_of(vertices: Points, faces: Faces) -> Signs:
    return read_signs(_geom.Topology(faces, len(vertices)), vertices, faces)


def parts_of(mesh: trimesh.Trimesh) -> tuple[Points, Faces]:
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.uint32)


def body(name: str) -> tuple[Points, Faces]:
    """A ball or a box of some twenty thousand faces, the box with vertices on planes through all of it."""
    if name == "ball":
        return parts_of(trimesh.creation.icosphere(subdivisions=5))
    box = trimesh.creation.box((2.0, 1.5, 1.0))
    for _ in range(5):
        box = box.subdivide()
    return parts_of(box)


def elsewhere(vertices: Points, rng: np.random.Generator) -> Points:
    """The same turned, larger and far away."""
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    return np.asarray(250.0 * vertices @ turn.T + [1000.0, -500.0, 3.0])


@pytest.mark.parametrize("name", ["ball", "box"])
@pytest.mark.parametrize("kind", ["kinect1", "kinect2", "fusion"])
def test_frames_and_fused_frames_get_the_weights_for_scans(name: str, kind: ScanKind) -> None:
    vertices, faces = body(name)
    pair = simulate(kind, vertices, faces, seed=4)
    signs = signs_of(pair.noisy_vertices, pair.faces)
    assert choose_preset(signs).preset == "scan", signs
    assert (signs.pixel_share > 0.5) == (kind != "fusion")
    assert (signs.voxel_share > 0.7) == (kind == "fusion")


@pytest.mark.parametrize(
    "sensor",
    [Kinect1(noise=0.1, window=0.5, steps_per_pixel=256.0), Kinect2(noise=0.2, depth_step=5e-5)],
    ids=["little and of each vertex", "little and shared"],
)
def test_frames_of_better_cameras_get_the_default(sensor: Kinect1 | Kinect2) -> None:
    vertices, faces = body("ball")
    kind: ScanKind = "kinect1" if isinstance(sensor, Kinect1) else "kinect2"
    pair = simulate(kind, vertices, faces, seed=4, setting=sensor)
    signs = signs_of(pair.noisy_vertices, pair.faces)
    assert signs.pixel_share > 0.5
    choice = choose_preset(signs)
    assert choice.preset == "default", signs
    assert "larger or wider" in choice.why


@pytest.mark.parametrize("name", ["ball", "box"])
@pytest.mark.parametrize("level", [0.0, 0.005, 0.05, 0.2, 0.6])
def test_noise_of_every_vertex_gets_the_default(name: str, level: float) -> None:
    vertices, faces = body(name)
    noisy = add_noise(vertices, faces, level=level, seed=2)
    assert choose_preset(signs_of(noisy, faces)).preset == "default"


@pytest.mark.parametrize("name", ["ball", "box"])
def test_prints_get_the_weights_for_scans(name: str) -> None:
    vertices, faces = body(name)
    pair = simulate("print", vertices, faces, seed=4)
    signs = signs_of(pair.noisy_vertices, pair.faces)
    choice = choose_preset(signs)
    assert choice.preset == "scan", signs
    assert f"lines every {signs.line_wavelength:.1f} mean edges" in choice.why
    assert signs.line_wavelength == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize(
    "lost",
    [
        {"line_share": 0.04},
        {"line_contrast": 14.0},
        {"line_reach": 0.7},
        {"line_weakest_side": 0.2},
        {"level": 0.009},
    ],
    ids=lambda lost: next(iter(lost)),
)
def test_lines_without_one_of_their_marks_are_a_shape(lost: dict[str, float]) -> None:
    printed = Signs(0.05, 0.3, 0.0, 0.0, 2.0, 0.2, 100.0, 1.0, 0.6, 4.0)
    assert choose_preset(printed).preset == "scan"
    assert choose_preset(replace(printed, **lost)).preset == "default"


@pytest.mark.parametrize("kind", ["impulsive", "isotropic", "varying"])
@pytest.mark.parametrize("name", ["ball", "box"])
def test_every_kind_of_noise_of_each_vertex_gets_the_default(name: str, kind: NoiseKind) -> None:
    vertices, faces = body(name)
    noisy = add_noise(vertices, faces, kind=kind, level=0.3, seed=6)
    assert choose_preset(signs_of(noisy, faces)).preset == "default"


def test_a_print_is_known_from_any_side_at_any_size_and_order_of_faces() -> None:
    vertices, faces = body("ball")
    pair = simulate("print", vertices, faces, seed=1)
    rng = np.random.default_rng(0)
    moved = elsewhere(pair.noisy_vertices, rng)
    straight = signs_of(pair.noisy_vertices, pair.faces)
    shuffled = signs_of(pair.noisy_vertices, np.ascontiguousarray(rng.permutation(pair.faces)))
    turned = signs_of(moved, pair.faces)
    assert shuffled.line_share == pytest.approx(straight.line_share, rel=1e-3)
    # Boxes are along the axes: turned, a surface is cut into other ones.
    assert turned.line_share == pytest.approx(straight.line_share, rel=0.3)
    assert turned.line_wavelength == pytest.approx(straight.line_wavelength, rel=0.05)
    assert choose_preset(turned).preset == choose_preset(straight).preset == "scan"


def test_an_open_surface_is_no_frame() -> None:
    vertices, faces = body("ball")
    half = faces[vertices[faces].mean(axis=1)[:, 2] > 0]
    noisy = add_noise(vertices, half, level=0.2, seed=1)
    assert signs_of(noisy, half).pixel_share < 0.2
    assert choose_preset(signs_of(noisy, half)).preset == "default"


def test_a_frame_is_known_from_any_side_at_any_size_and_order_of_faces() -> None:
    vertices, faces = body("ball")
    pair = simulate("kinect2", vertices, faces, seed=1)
    rng = np.random.default_rng(0)
    moved = elsewhere(pair.noisy_vertices, rng)
    shuffled = np.ascontiguousarray(rng.permutation(pair.faces))
    straight, turned = signs_of(pair.noisy_vertices, pair.faces), signs_of(moved, shuffled)
    assert turned.pixel_share == pytest.approx(straight.pixel_share, abs=1e-3)
    assert turned.correlation == pytest.approx(straight.correlation, abs=1e-3)
    assert turned.level == pytest.approx(straight.level, rel=1e-6)


def test_correlation_tells_noise_of_each_vertex_from_smooth_bumps() -> None:
    vertices, faces = body("ball")
    white = add_noise(vertices, faces, level=0.2, seed=3)
    bumps = add_noise(vertices, faces, kind="correlated", level=0.2, seed=3)
    assert signs_of(white, faces).correlation < -0.1
    assert signs_of(bumps, faces).correlation > 0.3


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        (np.zeros((3, 3)), [[0, 1, 2]]),
        (np.eye(3), [[0, 1, 2]]),
        (np.eye(4, 3), [[0, 1, 2], [0, 0, 1]]),
        (np.arange(9.0).reshape(3, 3) * 1e140, [[0, 1, 2]]),
        (np.arange(9.0).reshape(3, 3) * 1e-300, [[0, 1, 2]]),
    ],
    ids=["one point", "one face", "a collapsed face", "huge", "tiny"],
)
def test_meshes_without_signs_get_the_default(vertices: Points, faces: list[list[int]]) -> None:
    signs = signs_of(vertices, np.array(faces, dtype=np.uint32))
    assert np.isfinite([*signs.described().values()]).all()
    assert choose_preset(signs).preset == "default"


def test_auto_is_the_chosen_preset_bit_for_bit() -> None:
    vertices, faces = parts_of(trimesh.creation.icosphere(subdivisions=4))
    frame = simulate("kinect2", vertices, faces, seed=1, size=0.3)
    auto = Denoiser()
    for mesh, expected in (
        ((frame.noisy_vertices, frame.faces), "scan"),
        ((add_noise(vertices, faces, level=0.2, seed=1), faces), "default"),
    ):
        done = auto.run(mesh)
        assert np.array_equal(done.after, gcnd.denoise(mesh, preset=expected)[0])
        assert np.array_equal(done.after, gcnd.denoise(mesh)[0])
        method = done.report()["method"]
        assert (method["preset"], method["sha256"]) == (expected, auto.hashes[expected])
        assert method["why"]
        assert method["signs"]["level"] > 0


def test_auto_is_pickled_with_the_hash_of_every_candidate() -> None:
    copy = pickle.loads(pickle.dumps(Denoiser()))
    assert copy.preset == "auto"
    assert {*copy.cascades} == {*copy.hashes} == {*CANDIDATES}


def test_the_command_says_what_it_chose_and_why(tmp_path: Path) -> None:
    vertices, faces = parts_of(trimesh.creation.icosphere(subdivisions=4))
    frame = simulate("kinect2", vertices, faces, seed=1, size=0.3)
    save((frame.noisy_vertices, frame.faces), f"{tmp_path}/scan.ply")
    run = CliRunner().invoke(app, ["denoise", f"{tmp_path}/scan.ply", f"{tmp_path}/clean.ply"])
    assert run.exit_code == 0
    assert "preset scan: " in run.stderr
    assert "halves of a camera's pixels" in run.stderr
    told = CliRunner().invoke(app, ["denoise", f"{tmp_path}/scan.ply", f"{tmp_path}/c.ply", "--json"])
    assert json.loads(told.stdout)["preset"] == "scan"
    named = CliRunner().invoke(
        app, ["denoise", f"{tmp_path}/scan.ply", f"{tmp_path}/d.ply", "--preset", "fast"]
    )
    assert "halves" not in named.stderr
    info = json.loads(CliRunner().invoke(app, ["info", f"{tmp_path}/scan.ply", "--json"]).stdout)
    assert info["preset"] == "scan"
    assert info["pixel_share"] > 0.5
    printed = simulate("print", *body("ball"), seed=1)
    save((printed.noisy_vertices, printed.faces), f"{tmp_path}/print.ply")
    told = CliRunner().invoke(app, ["info", f"{tmp_path}/print.ply"])
    assert "lines every 4" in told.stdout
    assert "line share" in told.stdout


def test_info_names_the_preset_that_denoise_takes_for_faces_that_disagree(tmp_path: Path) -> None:
    vertices, faces = parts_of(trimesh.creation.icosphere(subdivisions=4))
    frame = simulate("kinect2", vertices, faces, seed=1, size=0.3)
    mixed = frame.faces.copy()
    turned = np.random.default_rng(0).random(len(mixed)) < 0.5
    mixed[turned] = mixed[turned][:, ::-1]
    mixed = np.concatenate([mixed, mixed[:50, ::-1]])
    # The premise: as it stands the mesh shows other signs.
    assert choose_preset(signs_of(frame.noisy_vertices, mixed)).preset == "default"
    save((frame.noisy_vertices, mixed), f"{tmp_path}/scan.ply")
    info = json.loads(CliRunner().invoke(app, ["info", f"{tmp_path}/scan.ply", "--json"]).stdout)
    assert info["duplicate_faces"] == 50
    assert info["misoriented_edges"] > 100
    with pytest.warns(gcnd.MeshWarning):
        done = Denoiser().run(f"{tmp_path}/scan.ply")
    assert info["preset"] == done.method["preset"] == "scan"
    assert info["why"] == done.method["why"]
    assert done.method["signs"].items() <= info.items()
    assert done.report()["noise_level"]["before"] == pytest.approx(info["level"], abs=1e-3)
