"""The report of a run: every figure against one worked out another way."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

import gcnd
from gcnd import Controls, Denoiser, _geom
from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.errors import GcndError
from gcnd.filters import Filter
from gcnd.mesh_io import MeshArrays, save
from gcnd.report import flipped_faces, make_report, noise_level, write_report
from gcnd.weights import list_models

BALL = trimesh.creation.icosphere(subdivisions=4)
FACES = BALL.faces.astype(np.uint32)
CLEAN = np.array(BALL.vertices)
TOPOLOGY = _geom.Topology(FACES, len(CLEAN))
NOISY = add_noise(CLEAN, FACES, level=0.3, seed=1)


def test_every_figure() -> None:
    after = NOISY.copy()
    after[:100] += [0.0, 0.3, 0.4]
    report = make_report(MeshArrays(NOISY, FACES), after, {"filter": "none"}, {"a": 1.25, "b": 0.5})
    edge = float(np.mean(trimesh.Trimesh(NOISY, FACES, process=False).edges_unique_length))
    assert report["versions"]["gcnd"] == gcnd.__version__
    assert report["versions"]["torch"].split("+")[0] == torch.__version__.split("+")[0]
    assert report["versions"]["numpy"] == np.__version__
    assert report["method"] == {"filter": "none"}
    assert report["seconds"] == {"a": 1.25, "b": 0.5, "total": 1.75}
    mean, rms = 0.5 * 100 / len(NOISY), 0.5 * (100 / len(NOISY)) ** 0.5
    assert report["displacement"] == pytest.approx(
        {
            "mean": mean,
            "rms": rms,
            "max": 0.5,
            "mean_edges": mean / edge,
            "rms_edges": rms / edge,
            "max_edges": 0.5 / edge,
            "moved_vertices": 100,
        }
    )
    mesh = report["mesh"]
    assert (mesh["vertices"], mesh["faces"]) == (len(NOISY), len(FACES))
    assert mesh["mean_edge_length"] == pytest.approx(edge)
    for name, vertices in (("volume_before", NOISY), ("volume_after", after)):
        assert mesh[name] == pytest.approx(trimesh.Trimesh(vertices, FACES, process=False).volume)
    assert json.loads(json.dumps(report)) == report


def test_parameters_of_a_filter_may_be_numbers_of_numpy() -> None:
    chosen = Filter(
        "bilateral-normal", sigma_r=np.float32(0.5), normal_iterations=np.int64(2), sigma_s=Fraction(1, 4)
    )
    report = json.loads(json.dumps(chosen.run((NOISY, FACES)).report()))
    known = {"sigma_r": 0.5, "normal_iterations": 2, "sigma_s": 0.25}
    assert report["method"]["parameters"].items() >= known.items()


def test_a_mesh_with_a_hole_has_no_volume() -> None:
    report = make_report(MeshArrays(NOISY, np.ascontiguousarray(FACES[1:])), NOISY, {}, {})
    assert (report["mesh"]["volume_before"], report["mesh"]["volume_after"]) == (None, None)
    assert report["displacement"]["max_edges"] == 0.0


def test_flipped_faces_are_those_folded_over() -> None:
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(6.0), np.arange(6.0)))
    vertices = np.stack([x, y, 0 * x], axis=1)
    squares = np.array([[i, i + 1, i + 7, i + 6] for i in range(30) if i % 6 != 5])
    faces = np.concatenate([squares[:, :3], squares[:, [0, 2, 3]]]).astype(np.uint32)
    topology = _geom.Topology(faces, 36)
    assert flipped_faces(topology, _geom.face_geometry(vertices, faces)[0]) == 0
    folded = vertices.copy()
    folded[14, 0] += 1.5  # past its neighbour: the triangles between the two turn over
    report = make_report(MeshArrays(vertices, faces), folded, {}, {})
    area = np.cross(folded[faces[:, 1]] - folded[faces[:, 0]], folded[faces[:, 2]] - folded[faces[:, 0]])[
        :, 2
    ]
    n_turned = int((area < 0).sum())
    assert n_turned == 2
    assert report["flipped_faces"]["before"] == 0
    assert report["flipped_faces"]["turned"] == n_turned
    assert 1 <= report["flipped_faces"]["after"] <= n_turned


@pytest.mark.parametrize("level", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_the_noise_is_found(level: float, scale: float) -> None:
    noisy = scale * add_noise(CLEAN, FACES, level=level, seed=7)
    assert noise_level(TOPOLOGY, noisy, FACES) == pytest.approx(level, rel=0.15)
    assert noise_level(TOPOLOGY, scale * CLEAN, FACES) < 0.01


def test_a_point_has_no_noise() -> None:
    faces = np.array([[0, 0, 0]], dtype=np.uint32)
    assert noise_level(_geom.Topology(faces, 1), np.zeros((1, 3)), faces) == 0.0


# --- of a run ----------------------------------------------------------------------------------------


def test_a_run_says_what_ran() -> None:
    small = trimesh.creation.icosphere(subdivisions=1)
    done = Denoiser("fast", seed=4, controls=Controls(strength=0.5)).run(small)
    report = done.report()
    model = next(model for model in list_models() if model.name == "fast")
    method = report["method"]
    assert (method["preset"], method["sha256"], method["seed"]) == ("fast", model.sha256, 4)
    assert method["precision"] in ("float32", "bfloat16")
    assert method["controls"]["strength"] == 0.5
    stages = list(report["seconds"])
    assert stages[:2] == ["reading", "adjacency"]
    assert stages[-3:] == ["finishing", "done", "total"]
    assert "normals, pass 1 of 3" in stages
    ways = np.linalg.norm(done.mesh.vertices - small.vertices, axis=1)
    assert report["displacement"]["max"] == pytest.approx(ways.max())


def test_a_filter_says_its_parameters() -> None:
    report = Filter("taubin", iterations=3).run((NOISY, FACES)).report()
    assert report["method"]["filter"] == "taubin"
    assert report["method"]["parameters"] == {
        "lambda_": 0.5,
        "mu": -0.53,
        "iterations": 3,
        "fix_boundary": True,
    }
    assert report["seconds"]["taubin"] > 0
    assert report["noise_level"]["after"] < 0.5 * report["noise_level"]["before"]


def test_the_command_writes_it(tmp_path: Path) -> None:
    source, out, report = tmp_path / "in.ply", tmp_path / "out.ply", tmp_path / "report.json"
    save((NOISY, FACES), source)
    report.write_text("old")
    assert main(["denoise", str(source), str(out), "--method", "taubin", "-q", "--report", str(report)]) == 0
    found = json.loads(report.read_text())
    assert (found["input"], found["output"]) == (str(source), str(out))
    assert found["seconds"]["writing"] > 0
    assert found["mesh"]["faces"] == len(FACES)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.ply", "out.ply", "report.json"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("in.ply", "another file of this run"),
        ("out.ply", "another file of this run"),
        ("no/a.json", "does not exist"),
        (".", "is a folder"),
    ],
)
def test_a_report_that_cannot_be_written_is_told_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, message: str
) -> None:
    source, out = tmp_path / "in.ply", tmp_path / "out.ply"
    save((NOISY, FACES), source)
    before = source.read_bytes()
    options = ["--method", "taubin", "-q", "--report", str(tmp_path / name)]
    assert main(["denoise", str(source), str(out), *options]) == 1
    assert message in capsys.readouterr().err
    assert not out.exists()
    assert source.read_bytes() == before


def test_writing_tells_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(GcndError, match=r"cannot write .*a\.json: No such file"):
        write_report(tmp_path / "none" / "a.json", {})


@pytest.mark.parametrize("doublings", [-700, -300, 400])
def test_displacements_are_right_at_any_size(doublings: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = np.array(ball.vertices), ball.faces.astype(np.uint32)
    moved = vertices.copy()
    moved[:7] *= 1.01
    found, usual = (
        make_report(MeshArrays(np.ldexp(vertices, n), faces), np.ldexp(moved, n), {}, {}, None)
        for n in (doublings, 0)
    )
    assert found["displacement"]["moved_vertices"] == 7
    for name, value in usual["displacement"].items():
        in_units = not (name.endswith("edges") or name == "moved_vertices")
        assert found["displacement"][name] == pytest.approx(
            float(np.ldexp(value, doublings * in_units)), rel=1e-12
        )
    assert found["mesh"]["mean_edge_length"] == float(np.ldexp(usual["mesh"]["mean_edge_length"], doublings))
