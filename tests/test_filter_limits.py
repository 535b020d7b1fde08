"""What every filter refuses, what it tells when it diverges, and which meshes it must take: tables over all of them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.cli import main
from gcnd.errors import ConfigError, GcndError, MeshError
from gcnd.filters import _COUNTS, _FILTERS, apply_filter, list_filters, parse_parameters
from gcnd.mesh_io import save
from gcnd.metrics import normal_angles
from reference.meshes import cube, jittered, open_sphere

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]
INFOS = list_filters()
NAMES = [info.name for info in INFOS]


def noisy_cube() -> Arrays:
    vertices, faces = cube(2)
    return jittered(vertices, 0.02, seed=1), faces


def run_core(method: str, mesh: Arrays, **options: Any) -> NDArray[np.float64]:
    """The core's filter itself, on positions as they are."""
    vertices, faces = mesh
    topology = _geom.Topology(faces.astype(np.uint32), len(vertices))
    return _FILTERS[method][0](topology, vertices, **options)


# --- parameters --------------------------------------------------------------------------------------

POSITIVE = (0.0, -1.0, float("nan"), float("inf")), "a positive finite number"
NOT_NEGATIVE = (-1e-9, float("nan"), float("inf")), "a finite number, 0 or more"
FRACTION = (-0.01, 1.01, float("nan")), "0 to 1"
STEP = (0.0, -0.5, 1.01, float("nan")), "above 0 and at most 1"
COUNT = (-1,), "0 or more"
SWITCH = (0, 1, "true"), "true or false"

RANGES: dict[str, dict[str, tuple[tuple[Any, ...], str]]] = {
    "bilateral": {"iterations": COUNT},
    "bilateral-normal": {
        "sigma_r": POSITIVE,
        "sigma_s": POSITIVE,
        "normal_iterations": COUNT,
        "vertex_iterations": COUNT,
        "fix_boundary": SWITCH,
    },
    "bilateral-normal-implicit": {
        "sigma_r": POSITIVE,
        "sigma_s": POSITIVE,
        "smoothness": ((0.0, 9e-5, 1.01, float("nan")), "0.0001 to 1"),
        "vertex_iterations": COUNT,
        "fix_boundary": SWITCH,
    },
    "guided-normal": {
        "sigma_r": POSITIVE,
        "sigma_s": POSITIVE,
        "radius": POSITIVE,
        "normal_iterations": COUNT,
        "vertex_iterations": COUNT,
        "fix_boundary": SWITCH,
    },
    "l0": {
        "lambda_": NOT_NEGATIVE,
        "alpha": NOT_NEGATIVE,
        "mu_alpha": STEP,
        "beta": POSITIVE,
        "beta_max": POSITIVE,
        "mu_beta": ((1.0, 1.0009, float("nan"), float("inf")), "1.001 or more, finite"),
    },
    "fast-effective": {
        "threshold": ((-0.01, 1.0, float("nan")), "0 or more and below 1"),
        "normal_iterations": COUNT,
        "vertex_iterations": COUNT,
        "fix_boundary": SWITCH,
    },
    "tgv": {
        "alpha1": POSITIVE,
        "alpha0": POSITIVE,
        "beta": POSITIVE,
        "normal_iterations": COUNT,
        "vertex_iterations": COUNT,
        "fix_boundary": SWITCH,
    },
    "low-rank": {
        "sigma_m": POSITIVE,
        "similar_patches": ((-1, 0, 65, 2**64), "1 to 64"),
        "patch_size": ((-1, 0, 1, 513, 2**64), "2 to 512"),
        "search_rings": ((-1, 0, 33, 2**64), "1 to 32"),
        "normal_iterations": COUNT,
        "vertex_iterations": COUNT,
        "fix_boundary": SWITCH,
        "fixed_step": SWITCH,
    },
    "laplacian": {"lambda_": STEP, "iterations": COUNT, "fix_boundary": SWITCH},
    "taubin": {
        "lambda_": STEP,
        "mu": ((-0.5, -0.1, 0.0, -2.01, float("nan")), "-2 or more and below -lambda"),
        "iterations": COUNT,
        "fix_boundary": SWITCH,
    },
    "hc-laplacian": {"alpha": FRACTION, "beta": FRACTION, "iterations": COUNT, "fix_boundary": SWITCH},
}
CASES = [(method, name, *ranges) for method, names in RANGES.items() for name, ranges in names.items()]


def test_the_table_has_every_parameter_of_every_filter() -> None:
    assert {method: set(names) for method, names in RANGES.items()} == {
        info.name: set(info.parameters) for info in INFOS
    }


@pytest.mark.parametrize(
    ("method", "name", "values", "allowed"), CASES, ids=[f"{case[0]}-{case[1]}" for case in CASES]
)
def test_a_parameter_out_of_range_is_named_with_its_value_and_what_is_allowed(
    method: str, name: str, values: tuple[Any, ...], allowed: str
) -> None:
    shown = {"lambda_": "lambda"}.get(name, name)
    for value in values:
        with pytest.raises(ConfigError) as error:
            apply_filter(noisy_cube(), method, **{name: value})
        told, _, range_told = str(error.value).partition(", allowed: ")
        assert range_told == allowed
        told_name, _, told_value = told.partition(" is ")
        assert told_name == (name if allowed == "true or false" else shown)
        if isinstance(value, float):
            assert float(told_value) == value or (told_value == "NaN" and np.isnan(value))
        else:
            assert told_value == repr(value)


@pytest.mark.parametrize(
    ("method", "name"), [case[:2] for case in CASES], ids=[f"{case[0]}-{case[1]}" for case in CASES]
)
def test_a_parameter_of_the_wrong_kind_is_named(method: str, name: str) -> None:
    default = next(info.parameters[name] for info in INFOS if info.name == method)
    is_count = isinstance(default, int) and not isinstance(default, bool)
    allowed = "a whole number" if is_count else "true or false" if isinstance(default, bool) else "a number"
    for value in ("7x", [1], 2.5) if is_count else ("7x", [1]):
        with pytest.raises(ConfigError) as error:
            apply_filter(noisy_cube(), method, **{name: value})
        assert str(error.value) == f"{name} is {value!r}, allowed: {allowed}"
    with pytest.raises(ConfigError) as error:
        parse_parameters(method, {name: "7x"})
    assert str(error.value) == f"{name} is 7x, allowed: {allowed}"
    if is_count:
        allowed = _COUNTS.get(name, "below 2**64")
        with pytest.raises(ConfigError, match=rf"{name} is {2**64}, allowed: {re.escape(allowed)}$"):
            apply_filter(noisy_cube(), method, **{name: 2**64})


def test_betas_that_never_end_are_named() -> None:
    with pytest.raises(ConfigError, match=r"beta is .*, allowed: so near to beta_max that mu_beta"):
        apply_filter(noisy_cube(), "l0", beta=1e-300, mu_beta=1.001)


# --- divergence --------------------------------------------------------------------------------------

# Parameters inside their ranges at which a filter diverges, and the iterations in which it may be told.
DIVERGING: list[tuple[str, dict[str, Any], tuple[int, int]]] = [
    ("taubin", {"lambda_": 0.1, "mu": -2.0, "iterations": 500}, (2, 20)),
    ("taubin", {"lambda_": 1e-3}, (2, 10)),
    ("taubin", {"mu": -2.0}, (2, 10)),
    ("hc-laplacian", {"alpha": 0.0, "beta": 0.0, "iterations": 500}, (5, 100)),
    ("l0", {"alpha": 1e15}, (2, 2)),
    ("l0", {"alpha": 1.7e308}, (2, 2)),
    ("l0", {"alpha": 1.0, "mu_alpha": 1.0, "beta_max": 1e17}, (80, 140)),
    ("tgv", {"alpha1": 1e16}, (1, 1)),
    ("tgv", {"alpha1": 1.7e308, "alpha0": 1e308}, (1, 1)),
    ("tgv", {"alpha0": 1e16}, (3, 3)),
    ("tgv", {"beta": 1e-16}, (1, 1)),
]


@pytest.mark.parametrize(("method", "parameters", "when"), DIVERGING)
def test_divergence_is_told_with_its_iteration_and_the_input_is_kept(
    method: str, parameters: dict[str, Any], when: tuple[int, int]
) -> None:
    mesh = noisy_cube()
    before = mesh[0].copy()
    heard: list[int] = []
    with pytest.raises(
        GcndError, match=r"the filter diverged in iteration \d+; the input is unchanged"
    ) as error:
        run_core(method, mesh, progress=lambda iteration, _: heard.append(iteration), **parameters)
    iteration = int(str(error.value).split("iteration ")[1].split(";")[0])
    assert when[0] <= iteration <= when[1]
    assert heard == list(range(1, iteration)), "each iteration before it was heard of, and none after"
    assert error.value.hint == "choose milder parameters"
    with pytest.raises(GcndError, match="diverged"):
        apply_filter(mesh, method, **parameters)
    assert np.array_equal(mesh[0], before)


def test_divergence_writes_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "in.ply", tmp_path / "out.ply"
    save(noisy_cube(), source)
    before = source.read_bytes()
    options = ["--method", "taubin", "--param", "lambda=0.1", "--param", "mu=-2", "--param", "iterations=500"]
    assert main(["denoise", str(source), str(out), "-q", *options]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: the filter diverged in iteration ")
    assert "hint: choose milder parameters" in error
    assert source.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["in.ply"]


def moved_or_error(
    method: str, mesh: Arrays, **options: Any
) -> tuple[NDArray[np.float64] | None, GcndError | None]:
    """What the filter gives, or what it raises."""
    try:
        return run_core(method, mesh, **options), None
    except GcndError as error:
        return None, error


EXTREMES = (5e-324, 1e-200, 1e-20, 1e-6, 1e6, 1e20, 1e200, 1.7e308)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("mesh", [noisy_cube(), cube(2)], ids=["noisy", "clean"])
def test_whatever_is_allowed_gives_a_mesh_in_its_place_or_tells_that_it_diverged(
    method: str, mesh: Arrays
) -> None:
    defaults = next(info.parameters for info in INFOS if info.name == method)
    low, high = mesh[0].min(axis=0) - 1.0, mesh[0].max(axis=0) + 1.0
    diverged = set()
    for name, default in defaults.items():
        for value in () if isinstance(default, bool | int) else EXTREMES:
            moved, error = moved_or_error(method, mesh, **{name: value})
            if moved is not None:
                assert ((moved >= low) & (moved <= high)).all(), f"{name} = {value}"
            elif not isinstance(error, ConfigError):
                assert "diverged in iteration" in str(error)
                diverged.add(name)
    can_diverge = {(name, key) for name, parameters, _ in DIVERGING for key in parameters}
    assert {(method, name) for name in diverged} <= can_diverge, "each has its row in the table"


@pytest.mark.parametrize("method", NAMES)
def test_coordinates_near_the_largest_number(method: str) -> None:
    vertices, faces = noisy_cube()
    expected = run_core(method, (vertices, faces))
    scale = 2.0**1022
    moved = run_core(method, (vertices * scale, faces))
    assert np.abs(moved / scale - expected).max() < 1e-9
    with pytest.raises(MeshError, match="vertex"):
        apply_filter((vertices * scale, faces), method)


@pytest.mark.parametrize("method", NAMES)
def test_one_vertex_at_the_largest_number(method: str) -> None:
    """The others are as good as one point then: what is asked for is an answer that is a number, or the error."""
    vertices, faces = noisy_cube()
    for far in (1e30, 1e149, 1.7e308):
        spoilt = vertices.copy()
        spoilt[7] = far
        before = spoilt.copy()
        moved, error = moved_or_error(method, (spoilt, faces))
        assert "diverged in iteration" in str(error) if moved is None else np.isfinite(moved).all()
        assert np.array_equal(spoilt, before)


# --- meshes ------------------------------------------------------------------------------------------


def with_zero_areas(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """An edge's middle as a vertex of one side only, a face that closes the slit, and faces of one and two vertices."""
    a, b, c = faces[40]
    middle = len(vertices)
    split = [[a, middle, c], [middle, b, c], [a, b, middle], [c, c, b], [c, c, c]]
    vertices = np.vstack([vertices, vertices[[a, b]].mean(axis=0)])
    return vertices, np.vstack([np.delete(faces, 40, axis=0), split])


def with_fins(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """A third face on each of three edges, and the same face twice."""
    fins = []
    for face in (10, 60, 110):
        a, b, c = faces[face]
        vertices = np.vstack([vertices, 1.05 * vertices[[a, b, c]].mean(axis=0)])
        fins.append([a, b, len(vertices) - 1])
    return vertices, np.vstack([faces, fins, faces[150:151]])


APART = np.array([0.0, 0.0, 3.0])


def with_components(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """A second piece, a face of its own and a vertex of none."""
    n = len(vertices)
    alone = [[5.0, 0.0, 0.0], [5.1, 0.0, 0.0], [5.0, 0.1, 0.0], [0.0, 5.0, 0.0]]
    moved = vertices + APART
    return np.vstack([vertices, moved, alone]), np.vstack([faces, faces + n, [[2 * n, 2 * n + 1, 2 * n + 2]]])


MESHES = {
    "boundary": lambda vertices, faces: (vertices, faces),
    "zero-area faces": with_zero_areas,
    "non-manifold edges": with_fins,
    "several components": with_components,
}


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("method", NAMES)
def test_defects_do_not_keep_a_filter_from_its_work(method: str, kind: str) -> None:
    clean, faces = open_sphere(4)
    noisy = jittered(clean, 0.01, seed=4)
    mesh = MESHES[kind](noisy, faces)
    before = mesh[0].copy()
    moved, kept = apply_filter(mesh, method)
    assert np.array_equal(kept, mesh[1])
    assert np.array_equal(mesh[0], before)
    assert np.isfinite(moved).all()
    assert np.abs(moved - before).max() < 0.25
    # The sphere's own faces are as much better as they are without the defects, but for those at them.
    before_all, after_all = (normal_angles(v[: len(clean)], clean, faces).mean() for v in (noisy, moved))
    alone = normal_angles(apply_filter((noisy, faces), method)[0], clean, faces).mean()
    assert after_all < 0.75 * before_all
    assert after_all < 1.15 * alone
    if kind == "several components":
        second = moved[len(clean) : 2 * len(clean)] - APART
        assert np.abs(second - moved[: len(clean)]).max() < 1e-6
        assert np.array_equal(moved[-1], before[-1]), "a vertex of no face stays"


@pytest.mark.parametrize("method", NAMES)
def test_boundaries_are_held_or_freed(method: str) -> None:
    clean, faces = open_sphere(4)
    mesh = jittered(clean, 0.01, seed=4), faces
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(unique[counts == 1])
    assert len(rim) > 10
    if "fix_boundary" not in next(info.parameters for info in INFOS if info.name == method):
        assert method in {"bilateral", "l0"}
        return
    held, free = (apply_filter(mesh, method, fix_boundary=is_fixed)[0] for is_fixed in (True, False))
    assert np.array_equal(held[rim], mesh[0][rim])
    assert (np.abs(free[rim] - mesh[0][rim]).max(axis=1) > 1e-6).mean() > 0.9
