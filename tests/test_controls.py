"""Controls over a result: strength, limits, what is kept, volume; by any method."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray

from gcnd.controls import Controls
from gcnd.data.noise import add_noise
from gcnd.errors import ConfigError, MeshError
from gcnd.filters import apply_filter
from gcnd.mesh_io import MeshArrays, load, save, to_arrays

BALL = trimesh.creation.icosphere(subdivisions=3)
FACES = BALL.faces.astype(np.uint32)
VERTICES = add_noise(np.array(BALL.vertices), FACES, level=0.3, seed=1)
MESH = MeshArrays(VERTICES, FACES)
EDGE = float(np.mean(BALL.edges_unique_length))
MOVED = VERTICES + 0.2 * EDGE * np.random.default_rng(0).normal(size=VERTICES.shape)


def steered(controls: Controls, moved: NDArray[np.float64] = MOVED, mesh: Any = None) -> NDArray[np.float64]:
    arrays = MESH if mesh is None else to_arrays(mesh)[0]
    return controls.bind(mesh, arrays)[1](moved)


def lengths(result: NDArray[np.float64], before: NDArray[np.float64] = VERTICES) -> NDArray[np.float64]:
    return np.linalg.norm(result - before, axis=1)


def bits(values: Any) -> bytes:
    return np.ascontiguousarray(values).tobytes()


def soup() -> MeshArrays:
    """Three vertices of its own for every face, some at −0."""
    vertices = VERTICES[FACES].reshape(-1, 3).copy()
    vertices[:, 0] = np.round(vertices[:, 0], 1)
    vertices[::2][vertices[::2] == 0.0] = -0.0
    return MeshArrays(vertices, np.arange(FACES.size, dtype=np.uint32).reshape(-1, 3))


# --- strength ----------------------------------------------------------------------------------------


def test_no_strength_keeps_every_bit() -> None:
    mesh = soup()
    assert np.signbit(mesh.vertices[mesh.vertices == 0.0]).any()
    welded, finish = Controls(strength=0.0).bind(None, mesh)
    assert bits(finish(welded.vertices + 1.0)) == bits(mesh.vertices)
    assert bits(steered(Controls(strength=0.0, preserve_volume=True))) == bits(VERTICES)


def test_full_strength_is_the_result_bit_for_bit() -> None:
    assert bits(steered(Controls())) == bits(MOVED)


@pytest.mark.parametrize("offset", [0.0, 1e9])
def test_every_way_grows_with_the_strength(offset: float) -> None:
    mesh, moved = (VERTICES + offset, FACES), MOVED + offset
    strengths = [0.0, 1e-9, 0.1, 0.25, 0.5, 0.75, 0.9999999, np.nextafter(1.0, 0.0), 1.0]
    ways = [np.abs(steered(Controls(s), moved, mesh) - mesh[0]) for s in strengths]
    for smaller, larger in pairwise(ways):
        assert (smaller <= larger).all()
    assert np.allclose(ways[4], 0.5 * ways[-1], atol=1e-12 + 1e-16 * offset)
    assert ways[-1].max() > 0.3 * EDGE


def test_half_a_filter_is_half_of_its_way() -> None:
    full, _ = apply_filter((VERTICES, FACES), "taubin")
    half, _ = apply_filter((VERTICES, FACES), "taubin", controls=Controls(strength=0.5))
    assert np.abs(half - 0.5 * (full + VERTICES)).max() < 1e-14
    assert lengths(full).max() > 0.1 * EDGE


# --- how far -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e7, 1e15])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.float16])
def test_no_vertex_moves_further(dtype: Any, offset: float) -> None:
    vertices = np.minimum(VERTICES + offset, np.finfo(dtype).max / 2).astype(dtype)
    _, rebuild = to_arrays((vertices, FACES))
    start = vertices.astype(np.float64)
    way = MOVED - VERTICES
    for limit in (0.0, 1e-3, 0.1 * EDGE, 0.3 * EDGE, float(np.median(np.linalg.norm(way, axis=1)))):
        # Far away, rounding puts vertices at one position.
        welded, finish = Controls(max_displacement=limit).bind(None, MeshArrays(start, FACES))
        result, _ = rebuild(finish(welded.vertices + way[: len(welded.vertices)]))
        assert result.dtype == dtype
        ways = result.astype(np.float64) - start
        assert np.linalg.norm(ways, axis=1).max() <= limit
        assert np.sqrt(ways[:, 0] ** 2 + ways[:, 1] ** 2 + ways[:, 2] ** 2).max() <= limit
        if offset == 0.0 and limit > 0.05 * EDGE and dtype != np.float16:
            assert np.linalg.norm(ways, axis=1).max() > 0.9999 * limit


@pytest.mark.parametrize("scale", [1e-160, 1e-200, 1e-300])
def test_no_vertex_moves_further_where_squares_of_lengths_underflow(scale: float) -> None:
    mesh, limit = (scale * VERTICES, FACES), 0.1 * EDGE
    result = steered(Controls(max_displacement=limit * scale), scale * MOVED, mesh)
    ways = (result - mesh[0]) / scale
    assert 0.9999 * limit < np.linalg.norm(ways, axis=1).max() <= limit * (1.0 + 1e-12)


def test_shorter_ways_stay_as_they_are() -> None:
    limit = float(np.median(lengths(MOVED)))
    result = steered(Controls(max_displacement=limit))
    is_short = lengths(MOVED) < 0.999 * limit
    assert 0.4 < is_short.mean() < 0.6
    assert bits(result[is_short]) == bits(MOVED[is_short])
    turned = np.cross(result[~is_short] - VERTICES[~is_short], MOVED[~is_short] - VERTICES[~is_short])
    assert np.abs(turned).max() < 1e-15


def test_a_limit_in_mean_edges_and_the_smaller_of_two() -> None:
    edge = float(np.mean(trimesh.Trimesh(VERTICES, FACES, process=False).edges_unique_length))
    assert lengths(steered(Controls(max_displacement_edges=0.1))).max() == pytest.approx(0.1 * edge)
    both = Controls(max_displacement=0.05 * edge, max_displacement_edges=0.1)
    assert lengths(steered(both)).max() == pytest.approx(0.05 * edge)
    both = Controls(max_displacement=0.2 * edge, max_displacement_edges=0.1)
    assert lengths(steered(both)).max() == pytest.approx(0.1 * edge)


@pytest.mark.parametrize("format", ["ply", "stl", "off", "obj"])
def test_the_limit_holds_in_files(tmp_path: Path, format: str) -> None:
    path, out = tmp_path / f"in.{format}", tmp_path / f"out.{format}"
    save((VERTICES.astype(np.float32).astype(np.float64), FACES), path)
    save(apply_filter(path, "laplacian", controls=Controls(max_displacement=0.1 * EDGE)), out)
    found = lengths(load(out).vertices, load(path).vertices)
    assert 0.0999 * EDGE < found.max() <= 0.1 * EDGE


# --- what is kept ------------------------------------------------------------------------------------


def test_a_mask_keeps_every_bit_and_nothing_else() -> None:
    keep = VERTICES[:, 2] > 0.3
    result = steered(Controls(keep=keep))
    assert bits(result[keep]) == bits(VERTICES[keep])
    assert bits(result[~keep]) == bits(MOVED[~keep])
    with_volume = steered(Controls(keep=torch.tensor(keep), preserve_volume=True, max_displacement_edges=1.0))
    assert bits(with_volume[keep]) == bits(VERTICES[keep])
    assert (with_volume[~keep] != VERTICES[~keep]).any(axis=1).all()


def test_vertices_at_a_kept_position_stay_too() -> None:
    mesh = soup()
    keep = np.zeros(len(mesh.vertices), dtype=bool)
    keep[5] = True
    welded, finish = Controls(keep=keep).bind(None, mesh)
    result = finish(welded.vertices + 1.0)
    same = (mesh.vertices == mesh.vertices[5]).all(axis=1)
    assert same.sum() >= 5
    assert bits(result[same]) == bits(mesh.vertices[same])
    assert (result[~same] == mesh.vertices[~same] + 1.0).all()


@pytest.mark.parametrize(
    "values", [np.array([0, 3], np.uint8), np.array([0.0, -0.5]), np.array([False, True])]
)
def test_an_attribute_keeps_where_it_is_not_0(values: Any) -> None:
    keep = np.arange(len(VERTICES)) % 2 == 1
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    mesh.vertex_attributes["region"] = values[keep.astype(int)]
    result = steered(Controls(keep="region"), mesh=mesh)
    assert bits(result[keep]) == bits(VERTICES[keep])
    assert bits(result[~keep]) == bits(MOVED[~keep])


def test_an_attribute_of_a_file(tmp_path: Path) -> None:
    keep = np.arange(len(VERTICES)) < 100
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    mesh.vertex_attributes["region"] = keep.astype(np.uint8)
    save(mesh, tmp_path / "in.ply")
    before = load(tmp_path / "in.ply").vertices
    after = apply_filter(tmp_path / "in.ply", "taubin", controls=Controls(keep="region")).vertices
    assert bits(before[keep]) == bits(after[keep])
    assert lengths(after, before)[~keep].min() > 0


def test_attributes_where_other_libraries_have_them() -> None:
    keep = np.arange(len(VERTICES)) % 3 == 0
    for holder, values in (("point_data", keep), ("vertex", torch.tensor(keep))):
        mesh = SimpleNamespace(**{holder: {"region": values}})
        result = Controls(keep="region").bind(mesh, MESH)[1](MOVED)
        assert bits(result[keep]) == bits(VERTICES[keep])
        assert bits(result[~keep]) == bits(MOVED[~keep])


# --- volume ------------------------------------------------------------------------------------------


def volume(vertices: NDArray[np.float64], faces: NDArray[Any] = FACES) -> float:
    return float(trimesh.Trimesh(vertices, faces, process=False).volume)


def test_a_closed_mesh_keeps_its_volume() -> None:
    shrunk, _ = apply_filter((VERTICES, FACES), "laplacian")
    kept, _ = apply_filter((VERTICES, FACES), "laplacian", controls=Controls(preserve_volume=True))
    assert volume(shrunk) < 0.97 * volume(VERTICES)
    assert volume(kept) == pytest.approx(volume(VERTICES), rel=1e-11)
    # One distance for all, along the normals: a ball stays a ball.
    assert lengths(kept, shrunk) == pytest.approx(np.full(len(kept), lengths(kept, shrunk).mean()), rel=1e-9)


@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_each_body_keeps_its_own(offset: float) -> None:
    vertices = np.concatenate([VERTICES, 0.01 * VERTICES + 3.0]) + offset
    faces = np.concatenate([FACES, FACES[:, ::-1] + len(VERTICES)])
    moved = np.concatenate([0.9 * VERTICES, 0.012 * VERTICES + 3.0]) + offset
    result = steered(Controls(preserve_volume=True), moved, (vertices, faces)) - offset
    vertices = vertices - offset
    for part, ids in ((slice(None, len(VERTICES)), FACES), (slice(len(VERTICES), None), FACES[:, ::-1])):
        found, wanted = (volume(x[part] - x[part].mean(axis=0), ids) for x in (result, vertices))
        assert found == pytest.approx(wanted, rel=1e-5 if offset else 1e-10)


@pytest.mark.parametrize("doublings", [-1000, -300, 200, 480])
def test_the_volume_stays_at_any_size(doublings: int) -> None:
    shrunk = 0.9 * VERTICES
    usual = steered(Controls(preserve_volume=True, max_displacement_edges=0.5), shrunk)
    # Beside a vertex that no face uses, far away.
    far = np.array([[1e120, -1e120, 0.0]])
    mesh = np.concatenate([np.ldexp(VERTICES, doublings), far]), FACES
    moved = np.concatenate([np.ldexp(shrunk, doublings), far])
    result = steered(Controls(preserve_volume=True, max_displacement_edges=0.5), moved, mesh)
    assert bits(result[-1]) == bits(far[0])
    np.testing.assert_allclose(np.ldexp(result[:-1], -doublings), usual, rtol=0, atol=1e-12)


def test_limits_and_kept_vertices_go_before_the_volume() -> None:
    keep = VERTICES[:, 0] < 0.0
    moved = 0.9 * VERTICES
    free = steered(Controls(preserve_volume=True, keep=keep, max_displacement=0.2), moved)
    assert volume(free) == pytest.approx(volume(VERTICES), rel=1e-11)
    assert bits(free[keep]) == bits(VERTICES[keep])
    random = np.random.default_rng(3).normal(size=VERTICES.shape) * 0.03 - 0.02 * VERTICES
    tight = steered(Controls(preserve_volume=True, max_displacement=0.03), VERTICES + random)
    assert lengths(tight).max() <= 0.03
    loose = steered(Controls(max_displacement=0.03), VERTICES + random)
    assert abs(volume(tight) - volume(VERTICES)) < 1e-9 < 0.01 < abs(volume(loose) - volume(VERTICES))
    nothing = steered(Controls(preserve_volume=True, keep=np.ones(len(VERTICES), dtype=bool)), moved)
    assert bits(nothing) == bits(VERTICES)


@pytest.mark.parametrize(
    "again", [FACES[:7], FACES[:7, ::-1], FACES[:, ::-1]], ids=["some", "backs", "all backs"]
)
def test_repeated_faces_enclose_nothing_more(again: Any) -> None:
    faces = np.concatenate([FACES, again])
    once = steered(Controls(preserve_volume=True), 0.9 * VERTICES)
    assert volume(once) == pytest.approx(volume(VERTICES), rel=1e-11)
    assert bits(steered(Controls(preserve_volume=True), 0.9 * VERTICES, (VERTICES, faces))) == bits(once)


def test_unwelded_closed_meshes_are_closed() -> None:
    mesh = (VERTICES[FACES].reshape(-1, 3), np.arange(FACES.size).reshape(-1, 3))
    kept, faces = apply_filter(mesh, "laplacian", controls=Controls(preserve_volume=True))
    assert volume(kept, faces) == pytest.approx(volume(*mesh), rel=1e-11)


@pytest.mark.parametrize(
    ("faces", "n_open"),
    [
        (FACES[1:], 3),
        (np.concatenate([FACES[:1, ::-1], FACES[1:]]), 3),
        (np.concatenate([FACES[1:], FACES[1:2]]), 3),
    ],
    ids=["a hole", "a face turned over", "a hole, and a face twice"],
)
def test_without_an_inside_there_is_no_volume(faces: Any, n_open: int) -> None:
    mesh = MeshArrays(VERTICES, np.ascontiguousarray(faces))
    with pytest.raises(MeshError, match=f"encloses no volume: {n_open} edges") as error:
        Controls(preserve_volume=True).bind(None, mesh)
    assert "preserve_volume is for closed meshes" in str(error.value.hint)
    Controls().bind(None, mesh)


# --- errors ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strength": 1.5}, "strength is 1.5, allowed: 0 to 1"),
        ({"strength": -0.1}, "strength is -0.1, allowed: 0 to 1"),
        ({"strength": float("nan")}, "strength is nan, allowed: 0 to 1"),
        ({"strength": None}, "strength is None, allowed: 0 to 1"),
        ({"strength": True}, "strength is True, allowed: 0 to 1"),
        ({"max_displacement": -1}, "max_displacement is -1, allowed: 0 or more"),
        ({"max_displacement": float("inf")}, "max_displacement is inf, allowed: 0 or more"),
        ({"max_displacement_edges": "2e"}, "max_displacement_edges is '2e', allowed: 0 or more"),
    ],
)
def test_values_out_of_range(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Controls(**options)


@pytest.mark.parametrize(
    ("keep", "message"),
    [
        (np.zeros(3, dtype=bool), r"keep has shape \(3,\), and the mesh has 642 vertices"),
        (np.zeros(642), "keep is of type float64, allowed: booleans"),
        ([0, 1], "keep is of type int64, allowed: booleans"),
        ("absent", "the mesh has no vertex attribute 'absent'"),
        ("pair", r"vertex attribute 'pair' has shape \(642, 2\) and type float64"),
        ("holes", "vertex attribute 'holes' has values that are not finite"),
    ],
)
def test_what_cannot_be_kept(keep: Any, message: str) -> None:
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    mesh.vertex_attributes["pair"] = np.zeros((642, 2))
    mesh.vertex_attributes["holes"] = np.full(642, np.nan)
    with pytest.raises(ConfigError, match=message) as error:
        Controls(keep=keep).bind(mesh, MESH)
    if isinstance(keep, str) and keep == "absent":
        assert error.value.hint == "its vertex attributes: holes, pair"


def test_a_pair_has_no_attributes() -> None:
    with pytest.raises(ConfigError, match="no vertex attribute 'region'") as error:
        apply_filter((VERTICES, FACES), "taubin", controls=Controls(keep="region"))
    assert error.value.hint == "its vertex attributes: none"


def test_controls_say_what_they_are() -> None:
    mask = np.arange(10) < 4
    assert Controls(0.5, keep=mask).described() == {
        "strength": 0.5,
        "max_displacement": None,
        "max_displacement_edges": None,
        "keep": "4 vertices",
        "preserve_volume": False,
    }


def test_numbers_of_numpy_are_as_good() -> None:
    controls = Controls(
        np.float32(0.5),
        np.float32(0.1),
        np.float16(0.25),
        preserve_volume=np.bool_(True),  # type: ignore[arg-type]
    )
    described = json.loads(json.dumps(controls.described()))
    assert described == Controls(0.5, float(np.float32(0.1)), 0.25, preserve_volume=True).described()
    results = [bits(steered(Controls(max_displacement_edges=kind(0.25)))) for kind in (np.float32, float)]
    assert results[0] == results[1]


def test_positions_that_overflow_are_told() -> None:
    change: Callable[[NDArray[np.float64]], NDArray[np.float64]] = Controls().bind(None, MESH)[1]
    with pytest.raises(MeshError, match="left the range of numbers"):
        change(MOVED * np.inf)
