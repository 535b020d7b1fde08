"""Every adapter against a noisy ball: order kept, less noise, and its settings are the library's own defaults."""

from __future__ import annotations

import inspect
import re
from typing import Any

import numpy as np
import pytest

from compare_cases import ball
from gcnd.compare.adapters import LIBRARIES
from gcnd.metrics import normal_error

METHODS = [(library, name) for library, found in LIBRARIES.items() for name in found.methods]


def need(library: str) -> Any:
    # Of a library that is installed and lacks a system library, an import fails otherwise.
    return pytest.importorskip(LIBRARIES[library].module, exc_type=ImportError)


@pytest.mark.parametrize(("library", "name"), METHODS)
def test_a_method_lessens_the_noise_and_keeps_the_order(library: str, name: str) -> None:
    need(library)
    mesh = ball(subdivisions=4)
    noisy, faces = mesh.noisy.copy(), mesh.faces.copy()
    adapted = LIBRARIES[library].methods[name]
    moved, kept = adapted.make(**adapted.settings)(noisy, faces)
    assert np.array_equal(noisy, mesh.noisy)
    assert moved.shape == noisy.shape
    assert np.array_equal(np.sort(kept, axis=1), np.sort(faces, axis=1))
    assert np.isfinite(moved).all()
    distance = np.linalg.norm(moved - noisy, axis=1)
    assert 0 < distance.max() < 0.3
    assert normal_error(moved, mesh.truth, faces) < normal_error(mesh.noisy, mesh.truth, faces)


@pytest.mark.parametrize("name", ["humphrey", "taubin", "laplacian"])
def test_trimeshs_defaults(name: str) -> None:
    trimesh = need("trimesh")
    signature = inspect.signature(getattr(trimesh.smoothing, f"filter_{name}")).parameters
    settings = LIBRARIES["trimesh"].methods[name].settings
    assert {key: signature[key].default for key in settings} == settings
    assert signature.keys() - settings.keys() == {"mesh", "laplacian_operator"}


def test_trimeshs_taubin_counts_half_passes() -> None:
    need("trimesh")
    mesh = ball()
    make = LIBRARIES["trimesh"].methods["taubin"].make
    once = make(lamb=0.5, nu=0.5, iterations=1)(mesh.noisy, mesh.faces)[0]
    laplacian = LIBRARIES["trimesh"].methods["laplacian"]
    options = {**laplacian.settings, "iterations": 1, "volume_constraint": False}
    assert np.allclose(once, laplacian.make(**options)(mesh.noisy, mesh.faces)[0])


@pytest.mark.parametrize(("name", "function"), [("taubin", "smooth_taubin"), ("laplacian", "smooth")])
def test_pyvistas_defaults(name: str, function: str) -> None:
    pyvista = need("pyvista")
    signature = inspect.signature(getattr(pyvista.PolyData, function)).parameters
    settings = LIBRARIES["pyvista"].methods[name].settings
    assert {key: signature[key].default for key in settings} == settings


def test_meshlibs_defaults() -> None:
    library = need("meshlib")
    settings = LIBRARIES["meshlib"].methods["denoise"].settings
    defaults = library.DenoiseViaNormalsSettings()
    for name, value in settings.items():
        assert getattr(defaults, name) == pytest.approx(value)


@pytest.mark.parametrize(
    ("name", "function"),
    [
        ("two-step", "apply_coord_two_steps_smoothing"),
        ("taubin", "apply_coord_taubin_smoothing"),
        ("laplacian", "apply_coord_laplacian_smoothing"),
    ],
)
def test_meshlabs_defaults(name: str, function: str) -> None:
    library = need("pymeshlab")
    mesh = ball()
    results = []
    for options in ({}, LIBRARIES["pymeshlab"].methods[name].settings):
        meshes = library.MeshSet()
        meshes.add_mesh(library.Mesh(mesh.noisy, mesh.faces.astype(np.int32)))
        meshes.apply_filter(function, **options)
        results.append(meshes.current_mesh().vertex_matrix())
    assert np.array_equal(*results)


@pytest.mark.parametrize("name", ["taubin", "laplacian", "simple"])
def test_open3ds_defaults(name: str) -> None:
    library = need("open3d")
    documented = getattr(library.geometry.TriangleMesh, f"filter_smooth_{name}").__doc__
    for key, value in LIBRARIES["open3d"].methods[name].settings.items():
        found = re.search(rf"{key}: [\w.]+ = (-?[\d.]+)", documented)
        assert found is not None
        assert float(found[1]) == value
