"""The classical filters from Python: names and parameters, kinds of mesh, stopping, and an independent reference."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.cli import main
from gcnd.errors import ConfigError, GcndError, MeshError
from gcnd.filters import apply_filter, list_filters, parse_parameters
from gcnd.mesh_io import load, save
from reference import bilateral_normal as reference
from reference import tgv as tgv_reference
from reference.meshes import cube, jittered, open_sphere

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]
NAMES = [info.name for info in list_filters()]


def noisy_cube() -> Arrays:
    vertices, faces = cube(3)
    return jittered(vertices, 0.012, seed=1), faces


def normals_of(mesh: Arrays) -> NDArray[np.float64]:
    vertices, faces = mesh
    return _geom.face_geometry(np.ascontiguousarray(vertices), faces.astype(np.uint32))[0]


def normal_error(mesh: Arrays, truth: Arrays) -> float:
    return float(_geom.normal_angles(normals_of(mesh), normals_of(truth)).mean())


# --- results -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma_r", [0.2, 0.35])
@pytest.mark.parametrize("mesh", [noisy_cube(), (jittered(open_sphere(3)[0], 0.01, 2), open_sphere(3)[1])])
def test_bilateral_normal_is_the_reference(mesh: Arrays, sigma_r: float) -> None:
    vertices, faces = mesh
    expected = reference.denoise(vertices, faces, sigma_r=sigma_r)
    moved, _ = apply_filter(mesh, "bilateral-normal", sigma_r=sigma_r)
    assert np.abs(moved - expected).max() < 1e-12
    assert np.abs(moved - vertices).max() > 0.005


@pytest.mark.parametrize("weights", [(1.0, 0.5, 2.5), (0.5, 2.0, 1.0)])
@pytest.mark.parametrize("mesh", [noisy_cube(), (jittered(open_sphere(3)[0], 0.01, 2), open_sphere(3)[1])])
def test_tgv_is_the_reference(mesh: Arrays, weights: tuple[float, float, float]) -> None:
    alpha1, alpha0, beta = weights
    options = {"alpha1": alpha1, "alpha0": alpha0, "beta": beta}
    expected = tgv_reference.denoise(*mesh, **options, normal_iterations=20, vertex_iterations=5)
    moved, _ = apply_filter(mesh, "tgv", **options, normal_iterations=20, vertex_iterations=5)
    assert np.abs(moved - expected).max() < 1e-9
    assert np.abs(moved - mesh[0]).max() > 0.005


@pytest.mark.parametrize("method", NAMES)
def test_noise_is_removed_and_the_input_left_alone(method: str) -> None:
    truth = open_sphere(4)
    mesh = jittered(truth[0], 0.01, seed=4), truth[1]
    before = mesh[0].copy()
    moved, faces = apply_filter(mesh, method)
    assert np.array_equal(mesh[0], before)
    assert np.array_equal(faces, mesh[1])
    assert normal_error((moved, faces), truth) < 0.75 * normal_error(mesh, truth)


@pytest.mark.parametrize("method", NAMES)
def test_no_iterations_change_nothing(method: str) -> None:
    defaults = next(info.parameters for info in list_filters() if info.name == method)
    counts: dict[str, Any] = {name: 0 for name in defaults if name.endswith("iterations")}
    if method == "l0":
        counts = {"beta_max": 1e-3}
    vertices, _ = apply_filter(noisy_cube(), method, **counts)
    assert np.abs(vertices - noisy_cube()[0]).max() < 1e-15


@pytest.mark.parametrize("method", NAMES)
def test_repeated_positions_move_together(method: str) -> None:
    vertices, faces = noisy_cube()
    soup = vertices[faces.ravel()], np.arange(3 * len(faces)).reshape(-1, 3)
    expected, _ = apply_filter((vertices, faces), method)
    moved, _ = apply_filter(soup, method)
    assert np.abs(moved - expected[faces.ravel()]).max() < 1e-9


def test_kinds_of_mesh(tmp_path: Path) -> None:
    vertices, faces = noisy_cube()
    expected, _ = apply_filter((vertices, faces), "taubin")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert np.array_equal(apply_filter(mesh, "taubin").vertices, expected)
    save((vertices, faces), tmp_path / "mesh.off")
    assert np.abs(apply_filter(tmp_path / "mesh.off", "taubin").vertices - expected).max() < 1e-6
    assert apply_filter((vertices.astype(np.float32), faces), "taubin")[0].dtype == np.float32


def test_far_from_the_origin_is_the_same() -> None:
    vertices, faces = noisy_cube()
    expected, _ = apply_filter((vertices, faces), "guided-normal", normal_iterations=5)
    moved, _ = apply_filter((vertices + 4096.0, faces), "guided-normal", normal_iterations=5)
    assert np.abs(moved - 4096.0 - expected).max() < 1e-9


# --- parameters --------------------------------------------------------------------------------------


def test_parameters_are_told_with_their_defaults() -> None:
    infos = {info.name: info for info in list_filters()}
    assert infos["fast-effective"].parameters == {
        "threshold": 0.5,
        "normal_iterations": 20,
        "vertex_iterations": 50,
        "fix_boundary": True,
    }
    assert infos["l0"].parameters["lambda_"] is None
    assert all(info.description and info.source for info in infos.values())
    assert len(infos) >= 10


def test_the_reference_page_has_every_filter_with_its_source_and_defaults() -> None:
    page = (Path(__file__).parents[1] / "docs" / "reference" / "filters.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    for info, row in zip(list_filters(), rows, strict=True):
        shown = {name: value if value is not None else "mesh" for name, value in info.parameters.items()}
        texts = {n: str(v).lower() if isinstance(v, bool) else str(v) for n, v in shown.items()}
        parameters = ", ".join(f"`{name.removesuffix('_')}` {text}" for name, text in texts.items())
        assert row == f"| `{info.name}` | {info.source} | {parameters} |"


def test_every_parameter_reaches_the_filter() -> None:
    mesh = jittered(open_sphere(2)[0], 0.03, 3), open_sphere(2)[1]
    other: dict[str, Any] = {
        "sigma_r": 0.5, "sigma_s": 0.07, "radius": 3.5, "smoothness": 0.3, "threshold": 0.7, "lambda_": 0.4,
        "alpha": 0.4, "mu": -0.8, "mu_alpha": 0.9, "beta": 0.02, "beta_max": 10.0, "alpha1": 3.0,
        "alpha0": 2.0, "mu_beta": 2.0,
        "fix_boundary": None, "fixed_step": None, "iterations": 3, "normal_iterations": 3, "vertex_iterations": 3,
        "sigma_m": 0.4, "similar_patches": 4, "patch_size": 20, "search_rings": 2,
    }  # fmt: skip
    for info in list_filters():
        usual, _ = apply_filter(mesh, info.name)
        for name, default in info.parameters.items():
            value = (not default) if isinstance(default, bool) else other[name]
            changed, _ = apply_filter(mesh, info.name, **{name: value})
            assert np.abs(changed - usual).max() > 1e-6, f"{info.name}: {name}"


@pytest.mark.parametrize(
    ("method", "parameters", "message"),
    [
        ("median", {}, r"there is no filter 'median'"),
        (["taubin"], {}, r"there is no filter \['taubin'\]"),
        ("laplacian", {"lambda": 0.1, "lambda_": 0.2}, r"laplacian is given lambda twice, allowed: once"),
        ("l0", {"sigma_r": 0.3}, r"l0 has no parameter 'sigma_r'"),
        ("guided-normal", {"sigma_r": 0.0}, r"sigma_r is 0, allowed: a positive finite number"),
        ("guided-normal", {"radius": "2"}, r"radius is '2', allowed: a number"),
        ("taubin", {"mu": -0.1}, r"mu is -0.1, allowed: -2 or more and below -lambda"),
        ("taubin", {"iterations": -1}, r"iterations is -1, allowed: 0 or more"),
        ("taubin", {"iterations": 2.5}, r"iterations is 2.5, allowed: a whole number"),
        ("taubin", {"fix_boundary": 1}, r"fix_boundary is 1, allowed: true or false"),
        ("tgv", {"alpha0": -1.0}, r"alpha0 is -1, allowed: a positive finite number"),
        ("hc-laplacian", {"alpha": float("nan")}, r"alpha is NaN, allowed: 0 to 1"),
        ("laplacian", {"lambda_": True}, r"lambda_ is True, allowed: a number"),
    ],
)
def test_wrong_parameters_are_named(method: str, parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        apply_filter(noisy_cube(), method, **parameters)


def test_parameters_from_text() -> None:
    assert parse_parameters("l0", {"lambda": "1e-3", "mu_beta": "2"}) == {"lambda_": 1e-3, "mu_beta": 2.0}
    for texts in ({"iterations": "2.5"}, {"fix_boundary": "1"}, {"lambda": "x"}):
        with pytest.raises(ConfigError, match=f"{next(iter(texts))} is {next(iter(texts.values()))}"):
            parse_parameters("taubin", texts)


# --- stopping and failing ----------------------------------------------------------------------------


@pytest.mark.parametrize("method", NAMES)
def test_progress_is_told_and_can_stop(method: str) -> None:
    told: list[tuple[float, str]] = []
    apply_filter(noisy_cube(), method, progress=lambda *step: told.append(step))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert (1.0, method) in told
    assert told[-1] == (1.0, "done")
    assert len(told) >= 5

    def stop(fraction: float, _: str) -> None:
        if fraction >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        apply_filter(noisy_cube(), method, progress=stop)


def test_diverging_is_told_with_the_iteration() -> None:
    with pytest.raises(GcndError, match=r"diverged in iteration \d+; the input is unchanged") as error:
        apply_filter(noisy_cube(), "taubin", lambda_=0.1, mu=-2.0, iterations=500)
    assert error.value.hint == "choose milder parameters"


@pytest.mark.parametrize("method", NAMES)
def test_meshes_that_cannot_be_worked_on(method: str) -> None:
    vertices, faces = noisy_cube()
    vertices[5, 1] = np.nan
    with pytest.raises(MeshError, match="vertex 5"):
        apply_filter((vertices, faces), method)


# --- the command line --------------------------------------------------------------------------------


@pytest.fixture
def mesh_path(tmp_path: Path) -> Path:
    path = tmp_path / "in.ply"
    save(noisy_cube(), path)
    return path


def test_denoise_with_a_filter(mesh_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = mesh_path.with_name("out.ply")
    options = ["--method", "bilateral-normal", "--param", "sigma_r=0.45", "--param", "fix-boundary=false"]
    options += ["--vertex-iterations", "5"]
    assert main(["denoise", str(mesh_path), str(out), "--json", "-q", *options]) == 0
    shown = json.loads(capsys.readouterr().out)
    parameters = {"vertex_iterations": 5, "sigma_r": 0.45, "fix_boundary": False}
    assert shown["method"] == "bilateral-normal"
    defaults = {info.name: info.parameters for info in list_filters()}["bilateral-normal"]
    assert shown["parameters"] == defaults | parameters
    assert "preset" not in shown
    expected = apply_filter(load(mesh_path), "bilateral-normal", **parameters)
    assert np.abs(load(out).vertices - expected.vertices).max() < 1e-6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--param", "sigma_r=1"], "error: --param is for filters"),
        (["--method", "l0", "--param", "alpha"], "error: --param is 'alpha', allowed: NAME=VALUE"),
        (["--method", "l1"], "error: there is no filter 'l1'"),
        (["--method", "l0", "--preset", "paper"], "error: --preset and --method exclude each other"),
        (["--method", "l0", "--normal-iterations", "3"], "error: l0 has no parameter 'normal_iterations'"),
    ],
)
def test_denoise_with_wrong_options(
    mesh_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply")), *options]) == 1
    assert capsys.readouterr().err.startswith(message)


def test_filters_need_no_torch() -> None:
    code = (
        "import sys, numpy as np; from gcnd.filters import apply_filter; "
        "apply_filter((np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3]])), 'l0'); "
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 0
