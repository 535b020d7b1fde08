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
from sheet_cases import angles, even_sheet

BALL = trimesh.creation.icosphere(subdivisions=3)
FACES = BALL.faces.astype(np.uint32)
NOISY = add_noise(np.array(BALL.vertices), FACES, level=0.2, seed=1)
TURNED = np.random.default_rng(0).choice(len(FACES), 200, replace=False)
MIXED = FACES.copy()
MIXED[TURNED] = MIXED[TURNED][:, [0, 2, 1]]
SMALL = trimesh.creation.icosphere(subdivisions=1)
BALL_80 = MeshArrays(np.array(SMALL.vertices), SMALL.faces.astype(np.uint32))


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
    oriented, topology, told, _ = as_surface(mesh)
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
    oriented, _, told, _ = as_surface(strip)
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


# --- little around a face ----------------------------------------------------------------------------

OPEN_SEVEN = MeshArrays(
    np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]),
    np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5]], dtype=np.uint32),
)
"""An octahedron less a face, of all open pieces so small the one with the fewest faces at its rim."""
TETRAHEDRON = MeshArrays(
    np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32)
)


def together(*meshes: MeshArrays) -> MeshArrays:
    """Apart from each other in one mesh."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return MeshArrays(
        np.concatenate([mesh.vertices + 9.0 * i for i, mesh in enumerate(meshes)]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]).astype(
            np.uint32
        ),
    )


def fan(n_faces: int) -> MeshArrays:
    angle = np.linspace(0.0, 3.0, n_faces + 1)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ids = np.arange(1, n_faces + 1)
    return MeshArrays(
        np.concatenate([[[0.0, 0, 0]], rim]), np.stack([0 * ids, ids, ids + 1], axis=1).astype(np.uint32)
    )


def test_faces_in_pairs_say_so() -> None:
    vertices, faces = even_sheet(20)
    quads = np.stack(np.split(faces, 2), axis=1).reshape(-1, 6)
    apart = np.concatenate([vertices[np.unique(quad)] for quad in quads])
    ids = [4 * i + np.searchsorted(np.unique(quad), quad).reshape(2, 3) for i, quad in enumerate(quads)]
    apart += 1e-5 * np.random.default_rng(0).normal(size=apart.shape)
    with pytest.warns(MeshWarning) as caught:
        Filter("taubin").run((apart, np.concatenate(ids)))
    assert [str(warning.message) for warning in caught] == [
        "all 800 faces are in open pieces of fewer than 8 faces, so that most have hardly a neighbourhood to learn "
        "from: vertices that belong together must be at exactly one position; merge them first"
    ]


@pytest.mark.parametrize(
    ("mesh", "told"),
    [
        (together(*[OPEN_SEVEN] * 3), "all 21 faces are in open pieces of fewer than 8 faces, "),
        (together(*[fan(7)] * 2), "all 14 faces are in open pieces of fewer than 8 faces, "),
        (together(*[fan(8)] * 2), None),
        (fan(8), None),
        (OPEN_SEVEN, "the mesh is one open piece of 7 faces: there is hardly a neighbourhood to learn from"),
        (fan(1), "the mesh is a single face: there is hardly a neighbourhood to learn from"),
        (TETRAHEDRON, None),
        (together(*[TETRAHEDRON] * 3), None),
        (together(*[TETRAHEDRON] * 10, *[fan(8)] * 3), None),
        (MeshArrays(np.array(trimesh.creation.box().vertices), trimesh.creation.box().faces.astype("u4")), None),
        # Most: 84 faces beside 80, and 77 beside 80.
        (together(*[OPEN_SEVEN] * 12, BALL_80), "84 of the 164 faces are in open pieces of fewer than 8 faces, "),
        (together(*[fan(7)] * 11, BALL_80), None),
    ],
    ids=[
        "sevens", "fans of seven", "fans of eight", "a fan of eight", "a seven", "a face", "a tetrahedron",
        "tetrahedra", "tetrahedra and fans", "a cube", "just most", "just not most",
    ],
)  # fmt: skip
def test_pieces_too_small_to_learn_from_say_so(mesh: MeshArrays, told: str | None) -> None:
    found = as_surface(mesh).told
    assert len(found) == (told is not None)
    assert "".join(found).startswith(told or "")


NO_AREA = "no face has an area: the corners of each lie on a line or at one point, and there is no surface"


@pytest.mark.parametrize("n_faces", [1, 2, 3000])
@pytest.mark.parametrize("place", [np.zeros(3), np.array([0.3, -0.7, 0.1])], ids=["a point", "a line"])
def test_faces_without_area_say_so(n_faces: int, place: np.ndarray) -> None:
    faces = np.arange(n_faces, dtype=np.uint32)[:, None] + np.arange(3, dtype=np.uint32)
    vertices = np.arange(float(n_faces + 2))[:, None] * place
    assert as_surface(MeshArrays(vertices, faces)).told == (NO_AREA,)
    # One face with an area, the last, is enough.
    vertices[-1] = [0.0, 0.0, 1.0]
    vertices[-2] += [0.0, 1.0, 0.0]
    assert NO_AREA not in as_surface(MeshArrays(vertices, faces)).told


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e150])
def test_a_surface_of_any_size_has_an_area(scale: float) -> None:
    assert as_surface(MeshArrays(scale * NOISY / np.abs(NOISY).max(), FACES)).told == ()


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
