"""Other libraries' meshes: the real ones, taken and returned with all that is not geometry."""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from library_cases import (
    CASES,
    FACES,
    KEEP,
    LABELS,
    VERTICES,
    all_kinds,
    expected_normals,
    legacy_mesh,
    old_normals,
    same,
    snapshot,
)

from gcnd import Controls, Denoiser, denoise
from gcnd.errors import ConfigError
from gcnd.filters import apply_filter
from gcnd.mesh_io import to_arrays
from gcnd.viewer.view import view


@all_kinds
def test_only_positions_and_normals_change(kind: str) -> None:
    make, positions, normals = CASES[kind]
    mesh = make()
    before = snapshot(mesh)
    result = apply_filter(mesh, "taubin")
    assert type(result) is type(mesh)
    after = snapshot(result)
    assert set(after) == set(before)
    changed = {name for name in before if not same(before[name], after[name])}
    assert changed == {positions, normals} | ({"triangle_normals"} if kind == "open3d" else set())
    expected, _ = apply_filter((before[positions], FACES), "taubin")
    assert same(after[positions], expected)
    assert np.abs(after[normals] - expected_normals(expected)).max() < 1e-6
    assert after[normals].dtype == before[normals].dtype
    assert all(same(value, before[name]) for name, value in snapshot(mesh).items()), "the input was modified"


@all_kinds
def test_no_strength_keeps_every_bit(kind: str) -> None:
    mesh = CASES[kind][0]()
    before, after = snapshot(mesh), snapshot(apply_filter(mesh, "taubin", controls=Controls(strength=0.0)))
    assert [name for name in before if not same(before[name], after[name])] == []


@all_kinds
def test_results_share_nothing_with_the_input(kind: str) -> None:
    make, positions, _ = CASES[kind]
    mesh = make()
    before = snapshot(mesh)
    arrays, rebuild = to_arrays(mesh)
    arrays.vertices[:] = 7.0
    arrays.faces[:] = 0
    result = rebuild(arrays.vertices + 1.0)
    if kind.startswith("pyvista"):
        result.point_data["heat"][:] = -1.0
        result.cell_data["label"][:] = -1
        result.points[:] = -1.0
    elif kind.startswith("meshio"):
        result.points[:], result.cells[0].data[:] = -1.0, 0
        result.point_data["uv"][:], result.cell_data["label"][0][:] = -1.0, -1
    elif kind == "open3d":
        np.asarray(result.vertices)[:] = -1.0
        np.asarray(result.triangle_uvs)[:] = -1.0
    else:
        result.vertex["positions"][:] = -1.0
        result.vertex["colors"][:] = 0
        result.triangle["label"][:] = 0
    assert all(same(value, before[name]) for name, value in snapshot(mesh).items())
    assert not same(snapshot(result)[positions], before[positions])


@all_kinds
def test_the_network_takes_and_returns_it(kind: str) -> None:
    make, positions, _ = CASES[kind]
    mesh = make()
    result = denoise(mesh, preset="fast", vertex_iterations=2)
    expected, _ = Denoiser("fast", vertex_iterations=2)((snapshot(mesh)[positions], FACES))
    assert type(result) is type(mesh)
    assert np.abs(snapshot(result)[positions] - expected).max() < 1e-6
    assert np.abs(expected - VERTICES).max() > 1e-3


@pytest.mark.parametrize("kind", [kind for kind in CASES if kind != "open3d"])
def test_vertices_are_kept_by_the_name_of_an_attribute(kind: str) -> None:
    make, positions, _ = CASES[kind]
    mesh = make()
    before = snapshot(mesh)[positions]
    after = snapshot(apply_filter(mesh, "taubin", controls=Controls(keep="region")))[positions]
    assert same(after[KEEP], before[KEEP])
    assert (after[~KEEP] != before[~KEEP]).any(axis=1).all()
    with pytest.raises(ConfigError, match="no vertex attribute 'absent'") as error:
        apply_filter(mesh, "taubin", controls=Controls(keep="absent"))
    assert "region" in str(error.value.hint)


def test_a_mesh_without_attributes_says_so() -> None:
    with pytest.raises(ConfigError, match="no vertex attribute 'region'"):
        apply_filter(legacy_mesh(), "taubin", controls=Controls(keep="region"))
    mask = apply_filter(legacy_mesh(), "taubin", controls=Controls(keep=KEEP))
    assert same(np.array(mask.vertices)[KEEP], VERTICES[KEEP])


@all_kinds
def test_it_can_be_viewed(kind: str, tmp_path: Any) -> None:
    mesh = CASES[kind][0]()
    figures = view(apply_filter(mesh, "taubin"), against=mesh, out=tmp_path / "view.html")
    assert figures.displacement_max > 0.05
    assert (tmp_path / "view.html").stat().st_size > 100_000


# --- normals, and what is imported -------------------------------------------------------------------


def test_a_seam_stays_smooth_and_a_sharp_edge_stays_sharp() -> None:
    pyvista = pytest.importorskip("pyvista")
    # Two faces at an edge, each with vertices of its own: as a seam (equal normals), or as a crease.
    points = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0.0], [0, 0, 0], [0, 1, 0], [1, 0, 0]])
    faces = np.array([[0, 1, 2], [3, 5, 4]])
    moved = points + np.array([[0, 0, 0], [0, 0, 0], [0, 0, -1], [0, 0, 0], [0, 0, 0], [0, 0, -1.0]])
    for is_seam in (True, False):
        mesh = pyvista.PolyData.from_regular_faces(points, faces)
        tilt = 0.0 if is_seam else 0.1
        normals = np.array([[-tilt, 0, 1], [-tilt, 0, 1], [0, 0, 1], [tilt, 0, 1], [tilt, 0, 1], [0, 0, 1]])
        mesh.point_data.active_normals = normals
        new = to_arrays(mesh)[1](moved).point_data.active_normals
        left, right = np.array([-1, 0, 1]) / np.sqrt(2), np.array([1, 0, 1]) / np.sqrt(2)
        expected = [[0, 0, 1], [0, 0, 1]] if is_seam else [left, right]
        assert np.allclose(new[[0, 3]], expected)
        assert np.allclose(new[[2, 5]], [left, right])


def test_normals_by_axis_and_of_a_class_derived() -> None:
    meshio = pytest.importorskip("meshio")

    class Scan(meshio.Mesh):  # type: ignore[misc, name-defined]
        pass

    columns = dict(zip(("nx", "ny", "nz"), old_normals().T.astype(np.float32), strict=True))
    mesh = Scan(VERTICES, [("triangle", FACES)], point_data={**columns, "normals": LABELS[: len(VERTICES)]})
    result = apply_filter(mesh, "taubin")
    assert type(result) is Scan
    found = np.column_stack([result.point_data[name] for name in columns])
    assert found.dtype == np.float32
    assert np.abs(found - expected_normals(result.points)).max() < 1e-6
    assert np.array_equal(result.point_data["normals"], LABELS[: len(VERTICES)])


def test_no_library_is_imported_for_another() -> None:
    # trimesh itself imports meshio where it is installed.
    code = (
        "import pickle, sys, numpy as np; from gcnd.filters import apply_filter;"
        "mesh = pickle.loads(sys.stdin.buffer.read()); apply_filter(mesh, 'taubin');"
        "print([name for name in ('pyvista', 'vtk', 'open3d', 'torch') if name in sys.modules])"
    )
    pair = pickle.dumps((VERTICES, FACES))
    done = subprocess.run([sys.executable, "-c", code], input=pair, capture_output=True, check=True)
    assert done.stdout.decode().strip() == "[]"
