"""Faces that disagree on which side is out, or that touch nothing: told, and oriented for the work."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

import gcnd
from gcnd import _geom
from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.errors import MeshWarning
from gcnd.filters import Filter
from gcnd.mesh_io import MeshArrays, load, save
from gcnd.surface import as_surface
from sheet_cases import angles

BALL = trimesh.creation.icosphere(subdivisions=3)
FACES = BALL.faces.astype(np.uint32)
NOISY = add_noise(np.array(BALL.vertices), FACES, level=0.2, seed=1)
TURNED = np.random.default_rng(0).choice(len(FACES), 200, replace=False)
MIXED = FACES.copy()
MIXED[TURNED] = MIXED[TURNED][:, [0, 2, 1]]


def disagreeing_edges(faces: np.ndarray) -> int:
    """An independent loop: edges that two faces run through in the same direction."""
    runs: dict[tuple[int, int], int] = {}
    for a, b, c in faces.tolist():
        for edge in ((a, b), (b, c), (c, a)):
            runs[edge] = runs.get(edge, 0) + 1
    return sum(count == 2 for count in runs.values())


def moebius() -> MeshArrays:
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    sides = [
        np.stack([r * np.cos(angle), r * np.sin(angle), w * np.sin(angle / 2)], axis=1)
        for w in (-0.3, 0.3)
        for r in [1.0 + w * np.cos(angle / 2)]
    ]
    here = np.arange(40)
    after = np.where(here == 39, 40, here + 1), np.where(here == 39, 0, here + 41)
    halves = [(here, after[0], here + 40), (here + 40, after[0], after[1])]
    return MeshArrays(
        np.concatenate(sides), np.concatenate([np.stack(h, 1) for h in halves]).astype(np.uint32)
    )


def test_the_result_is_that_of_the_oriented_mesh_with_the_faces_of_the_input() -> None:
    with pytest.warns(MeshWarning) as caught:
        done = gcnd.Denoiser("fast").run((NOISY, MIXED))
    (warning,) = caught
    assert str(warning.message).startswith(
        f"200 of 1,280 faces are turned against the rest of their component ({disagreeing_edges(MIXED)} edges"
    )
    vertices, faces = done.mesh
    assert np.array_equal(faces, MIXED)
    assert done.report()["warnings"] == [str(warning.message)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wanted = gcnd.Denoiser("fast").run((NOISY, FACES))
    assert wanted.report()["warnings"] == []
    assert np.array_equal(vertices, wanted.mesh[0])
    assert angles(vertices, np.array(BALL.vertices), FACES).mean() < 3.0


def test_the_warning_points_at_the_caller() -> None:
    with pytest.warns(MeshWarning) as caught:
        gcnd.denoise((NOISY, MIXED), preset="fast", vertex_iterations=0)
    assert caught[0].filename == __file__


def test_filters_are_told_too_and_work_on_the_oriented_mesh() -> None:
    with pytest.warns(MeshWarning, match="200 of 1,280 faces"):
        mixed = Filter("bilateral-normal").run((NOISY, MIXED)).mesh[0]
    assert np.array_equal(mixed, Filter("bilateral-normal").run((NOISY, FACES)).mesh[0])


def test_each_component_keeps_its_greater_part() -> None:
    inside_out = FACES[:, ::-1] + len(NOISY)
    mesh = MeshArrays(
        np.concatenate([NOISY, NOISY + 5.0]), np.concatenate([MIXED, inside_out]).astype(np.uint32)
    )
    oriented, topology, told = as_surface(mesh)
    assert np.array_equal(oriented.faces[: len(FACES)], FACES)
    assert np.array_equal(oriented.faces[len(FACES) :], inside_out)
    expected = _geom.Topology(oriented.faces, len(mesh.vertices))
    for rows, wanted in zip(topology.edge_neighbors(), expected.edge_neighbors(), strict=True):
        assert np.array_equal(rows, wanted)
    assert len(told) == 1
    assert told[0].startswith("200 of 2,560 faces")


def test_a_consistent_mesh_is_itself() -> None:
    mesh = MeshArrays(NOISY, FACES)
    surface = as_surface(mesh)
    assert surface.mesh is mesh
    assert surface.told == ()


def test_a_one_sided_component_says_so() -> None:
    strip = moebius()
    oriented, _, told = as_surface(strip)
    assert disagreeing_edges(oriented.faces) == 1
    assert len(told) == 1
    assert "one-sided components" in told[0]
    assert "1 edges are left in 1 of them" in told[0]


def test_faces_that_touch_nothing_say_so() -> None:
    apart = NOISY[FACES] + 1e-3 * np.random.default_rng(1).normal(size=(len(FACES), 1, 3))
    soup = (apart.reshape(-1, 3), np.arange(3 * len(FACES)).reshape(-1, 3))
    with pytest.warns(MeshWarning, match="none of the 1,280 faces share an edge with another"):
        gcnd.denoise(soup, preset="fast")
    nearly = MeshArrays(soup[0], np.concatenate([soup[1], [[0, 1, 5]]]).astype(np.uint32))
    assert "only 2 of the 1,281 faces share an edge" in as_surface(nearly).told[0]
    # The same at exactly equal positions is a surface, as in an STL file.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gcnd.denoise((NOISY[FACES].reshape(-1, 3), soup[1]), preset="fast")


def test_the_program_tells_it_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "in.ply", tmp_path / "out.ply"
    save((NOISY, MIXED), source)
    assert main(["denoise", str(source), str(out), "--method", "taubin", "--quiet"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("warning: 200 of 1,280 faces are turned")
    assert np.array_equal(load(out).faces, MIXED)


def test_a_folder_names_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    save((NOISY, MIXED), tmp_path / "in" / "mixed.ply")
    save((NOISY, FACES), tmp_path / "in" / "right.ply")
    program = ["denoise", str(tmp_path / "in"), str(tmp_path / "out"), "--method", "taubin", "--quiet"]
    assert main(program) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning")]
    assert len(told) == 1
    assert told[0].startswith("warning: mixed.ply: 200 of 1,280 faces")
    assert main([*program, "--overwrite", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["files"]
    assert [len(row["warnings"]) for row in rows] == [1, 0]
