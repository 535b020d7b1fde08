"""Spikes: what is taken for one, what is not, and what becomes of it."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

import gcnd
from gcnd import Denoiser, MeshWarning, _geom
from gcnd.cli import main
from gcnd.data.noise import NoiseKind, add_noise
from gcnd.data.shapes import ShapeKind, make_shape
from gcnd.filters import Filter
from gcnd.mesh_io import save
from gcnd.report import noise_level
from gcnd.spikes import Spikes
from sheet_cases import even_sheet, sheet, with_noise


def found(vertices: np.ndarray, faces: np.ndarray) -> list[int]:
    faces = np.ascontiguousarray(faces, dtype=np.uint32)
    positions = np.ascontiguousarray(vertices, dtype=np.float64)
    return _geom.find_spikes(_geom.Topology(faces, len(positions)), positions)[0].tolist()


@pytest.mark.parametrize("kind", ["cad", "smooth", "feature"])
def test_no_vertex_of_a_generated_shape_is_a_spike(kind: ShapeKind) -> None:
    """Clean or with any noise that we train on; but one vertex drawn out is."""
    shape = make_shape(3000000, kind)
    assert found(shape.vertices, shape.faces) == []
    noises: tuple[NoiseKind, ...] = ("gaussian", "impulsive", "isotropic", "varying")
    for seed, noise in enumerate(noises):
        noisy = add_noise(shape.vertices, shape.faces, kind=noise, level=0.7, seed=seed)
        assert found(noisy, shape.faces) == []
    drawn_out = shape.vertices.copy()
    outwards = trimesh.Trimesh(shape.vertices, shape.faces, process=False).vertex_normals
    drawn_out[99] += 0.5 * np.ptp(shape.vertices, axis=0).max() * outwards[99]
    assert found(drawn_out, shape.faces) == [99]


def test_no_vertex_between_uneven_triangles_is_a_spike() -> None:
    """Areas from 1 to 1000; impulses in mean edges are many edges high among the small ones."""
    places = np.concatenate([[0.0], np.cumsum(np.geomspace(0.05, 1.6, 40))])
    vertices, faces = sheet(places, places)
    assert found(vertices, faces) == []
    spacing = np.gradient(places)
    local = np.minimum(spacing[:, None], spacing).ravel()
    rng = np.random.default_rng(0)
    for level in (0.2, 0.7):
        noisy = vertices.copy()
        noisy[:, 2] += level * local * rng.normal(size=len(vertices))
        assert found(noisy, faces) == []
        assert found(add_noise(vertices, faces, level=level), faces) == []


@pytest.mark.parametrize("sections", [4, 8, 32])
@pytest.mark.parametrize("height", [1.0, 5.0, 50.0])
def test_the_tip_of_a_cone_is_no_spike(height: float, sections: int) -> None:
    cone = trimesh.creation.cone(1.0, height, sections=sections)
    assert found(cone.vertices, cone.faces) == []


def test_where_spikes_go() -> None:
    """One inside comes down for good; one on a boundary comes back, moved as its foot was."""
    vertices, faces = even_sheet(8)
    tip, inside = len(vertices), 40
    vertices = np.concatenate([vertices, [[-1.0, 3.5, 9.0]]])
    vertices[inside, 2] = -7.0
    faces = np.concatenate([faces, [[4, 3, tip]]]).astype(np.uint32)
    spikes = Spikes(_geom.Topology(faces, len(vertices)), vertices)
    assert spikes.ids.tolist() == [inside, tip]
    lowered = spikes.taken_off(vertices)
    np.testing.assert_allclose(lowered[[inside, tip]], [[4.0, 4.0, 0.0], [0.0, 3.5, 0.0]], atol=1e-12)
    same = np.delete(np.arange(len(vertices)), [inside, tip])
    assert (lowered[same] == vertices[same]).all()
    moved = lowered + np.array([0.1, 0.0, 0.2])
    back = spikes.tips_put_back(moved)
    np.testing.assert_allclose(back[tip], [-0.9, 3.5, 9.2], atol=1e-12)
    assert (back[:tip] == moved[:tip]).all()


def test_without_spikes_nothing_is_copied() -> None:
    vertices, faces = even_sheet(8)
    spikes = Spikes(_geom.Topology(faces, len(vertices)), vertices)
    assert spikes.taken_off(vertices) is vertices
    assert spikes.tips_put_back(vertices) is vertices
    assert spikes.told() == ()


# --- told --------------------------------------------------------------------------------------------


def spiked() -> tuple[np.ndarray, np.ndarray]:
    """A noisy sheet with two spikes inside and one triangle that hangs on its rim."""
    vertices, faces = even_sheet(12)
    vertices = with_noise(vertices, 0, 0.1)
    vertices[[45, 110], 2] = [9.0, -7.0]
    vertices = np.concatenate([vertices, [[-1.0, 3.5, 9.0]]])
    return vertices, np.concatenate([faces, [[3, 4, len(vertices) - 1]]]).astype(np.uint32)


TOLD = (
    "spikes, single vertices far off the surface: 2 inside the surface, put on it; "
    "1 at tips of triangles on a rim, taken off for the work and put back"
)


def test_a_run_warns_and_reports_them() -> None:
    with pytest.warns(MeshWarning) as caught:
        done = Denoiser("fast").run(spiked())
    assert [str(warning.message) for warning in caught] == [TOLD]
    report = done.report()
    assert report["spikes"] == {"inside": 2, "on_rim": 1}
    assert report["warnings"] == [TOLD]
    with pytest.warns(MeshWarning) as caught:
        gcnd.denoise(spiked(), preset="fast", vertex_iterations=0)
    assert caught[0].filename == __file__


def test_without_spikes_nothing_is_told() -> None:
    vertices, faces = even_sheet(12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = Denoiser("fast").run((with_noise(vertices, 0), faces)).report()
    assert report["spikes"] == {"inside": 0, "on_rim": 0}


def test_a_filter_keeps_spikes_and_tells_none() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = Filter("taubin").run(spiked()).report()
    assert report["spikes"] is None


def test_those_of_the_input_are_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = spiked()
    looked_at = []

    def find(topology: _geom.Topology, positions: np.ndarray) -> object:
        looked_at.append(positions.copy())
        return find_spikes(topology, positions)

    find_spikes = _geom.find_spikes
    monkeypatch.setattr(_geom, "find_spikes", find)
    with pytest.warns(MeshWarning):
        done = Denoiser("fast").run((vertices, faces))
    report = done.report()
    # Of the result anew: it is another mesh.
    assert [np.array_equal(positions, vertices) for positions in looked_at] == [True, False]
    level = noise_level(_geom.Topology(faces, len(vertices)), vertices, faces)
    assert report["noise_level"]["before"] == level


def test_the_program_tells_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out, report = tmp_path / "in.ply", tmp_path / "out.ply", tmp_path / "run.json"
    save(spiked(), source)
    assert main(["denoise", str(source), str(out), "--preset", "fast", "-q", "--report", str(report)]) == 0
    assert capsys.readouterr().err.splitlines() == [f"warning: {TOLD}"]
    found = json.loads(report.read_text())
    assert (found["spikes"], found["warnings"]) == ({"inside": 2, "on_rim": 1}, [TOLD])
    assert main(["info", str(source), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["spikes"] == 3
