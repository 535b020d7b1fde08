"""The page of `gcnd view`: its figures, what it carries and what it refuses."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import gcnd
from gcnd.errors import ConfigError, GcndError, MeshError
from gcnd.mesh_io import save
from gcnd.viewer import view as view_module
from gcnd.viewer.changes import compare_meshes
from gcnd.viewer.page import Names, view_page
from view_cases import EDGE, FACES, LIFTED, SQUARE, Page, page_of


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "view.html"


def angle_of(first: Any, second: Any) -> float:
    cosine = np.dot(first, second) / np.linalg.norm(first) / np.linalg.norm(second)
    return float(np.degrees(np.arccos(cosine)))


# Face 0 lifted: edges (1, 0, 1) and (1, 1, 0), normal (-1, 1, 1).
TURN = angle_of([-1, 1, 1], [0, 0, 1])


# --- figures -----------------------------------------------------------------------------------------


def test_figures_by_hand(out: Path) -> None:
    figures = gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), out=out)
    assert (figures.faces, figures.vertices, figures.flipped) == (2, 4, 0)
    assert figures.mean_edge_length == pytest.approx(EDGE)
    assert figures.displacement_max == pytest.approx(1 / EDGE)
    assert figures.displacement_mean == pytest.approx(1 / EDGE / 4)
    assert figures.angle_max == pytest.approx(TURN)
    assert figures.angle_mean == pytest.approx(TURN / 2)
    assert (figures.e_a_before, figures.e_a_after) == (None, None)
    assert (figures.flipped_before, figures.flipped_after) == (None, None)


def test_the_confidence_is_a_layer_of_doubt(out: Path, tmp_path: Path) -> None:
    def doubts() -> list[float] | None:
        page = page_of(out)
        layers = {layer["name"]: layer for layer in json.loads(page.texts["manifest"])["layers"]}
        if "doubt" not in layers:
            return None
        layer = layers["doubt"]
        assert (layer["per"], layer["unit"]) == ("face", " %")
        return [float(value) / 65534 * layer["top"] for value in page.array("doubt-before", "<u2")]

    gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), confidence=[0.75, 1.0], out=out)
    assert doubts() == pytest.approx([25.0, 0.0], abs=0.01)
    mesh = trimesh.Trimesh(LIFTED, FACES, process=False)
    save(mesh, tmp_path / "plain.ply")
    mesh.face_attributes["confidence"] = np.array([0.5, 0.9], np.float32)
    save(mesh, tmp_path / "sure.ply")
    for after in (mesh, tmp_path / "sure.ply"):
        gcnd.view(after, against=(SQUARE, FACES), out=out)
        assert doubts() == pytest.approx([50.0, 10.0], abs=0.01)
    gcnd.view(tmp_path / "plain.ply", against=(SQUARE, FACES), out=out)
    assert doubts() is None


@pytest.mark.parametrize(
    ("confidence", "message"),
    [
        ([0.5], "confidence has 1 values, and the mesh 2 faces"),
        ([0.5, 1.5], "values outside 0 to 1"),
        ([0.5, float("nan")], "values outside 0 to 1"),
    ],
)
def test_a_confidence_that_is_none_is_refused(out: Path, confidence: list[float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), confidence=confidence, out=out)
    assert not out.exists()


def test_figures_against_the_truth(out: Path) -> None:
    # The corner 1 on the other side of the long edge turns face 0 over.
    flipped = np.array([[0.0, 0, 0], [0, 0.5, 0], [1, 1, 0], [0, 1, 0]])
    figures = gcnd.view((LIFTED, FACES), against=(flipped, FACES), truth=(SQUARE, FACES), out=out)
    assert figures.e_a_before == pytest.approx(90.0)
    assert figures.e_a_after == pytest.approx(TURN / 2)
    assert (figures.flipped_before, figures.flipped_after) == (1, 0)
    assert figures.angle_max == pytest.approx(180 - TURN)
    assert figures.flipped == 1


def test_vertices_without_a_face_do_not_count(out: Path) -> None:
    far = np.vstack([SQUARE, [[1e6, 0, 0]]])
    figures = gcnd.view((far + np.array([0, 0, 0.5]), FACES), against=(far, FACES), out=out)
    assert figures.vertices == 4
    assert figures.displacement_mean == pytest.approx(0.5 / EDGE)
    page = page_of(out)
    positions = page.array("positions-before", "<f4").reshape(-1, 3)
    assert len(positions) == 4
    # Shown in its own size, not as a dot in the frame of a vertex far away.
    assert np.linalg.norm(positions, axis=1).max() == pytest.approx(1.0, abs=0.1)


def test_a_face_without_area_before_has_no_angle(out: Path) -> None:
    line = SQUARE.copy()
    line[1] = 0.5
    line[1, 2] = 0.0
    figures = gcnd.view((SQUARE, FACES), against=(line, FACES), out=out)
    assert figures.angle_mean == pytest.approx(0.0)
    page = page_of(out)
    assert page.array("angle-before", "<u2").tolist() == [65535, 0]
    layers = {layer["name"]: layer for layer in json.loads(page.texts["manifest"])["layers"]}
    assert layers["angle"]["hasUnknown"] is True
    assert layers["displacement"]["hasUnknown"] is False


def test_nothing_but_faces_without_area(out: Path) -> None:
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    figures = gcnd.view((line, [[0, 1, 2]]), against=(line, [[0, 1, 2]]), truth=(line, [[0, 1, 2]]), out=out)
    assert np.isnan(figures.angle_mean)
    assert np.isnan(figures.e_a_after or 0.0)
    assert "–" in out.read_text(encoding="utf-8")


def test_the_scale_ends_where_most_values_do() -> None:
    from gcnd.mesh_io import to_arrays

    rng = np.random.default_rng(3)
    ball = trimesh.creation.icosphere(subdivisions=3)
    noisy, clean = (ball.vertices + rng.normal(0, s, ball.vertices.shape) for s in (0.03, 0.003))
    meshes = [to_arrays((vertices, ball.faces))[0] for vertices in (noisy, clean, ball.vertices)]
    layers, _ = compare_meshes(*meshes)
    assert [layer.name for layer in layers] == ["angle", "error", "displacement"]
    for layer, share in zip(layers, (0.95, 0.75, 0.95), strict=True):
        values = np.concatenate([layer.before, layer.after])
        assert np.mean(values <= layer.scale_end) >= share
        # A lower step of the scale would have done otherwise.
        assert np.mean(values <= layer.scale_end / 1.51) < share


# --- what the page carries ---------------------------------------------------------------------------


def test_positions_faces_and_values_are_in_the_page(out: Path) -> None:
    offset = np.array([1e7, -2e7, 3e7])
    gcnd.view(
        (LIFTED + offset, FACES), against=(SQUARE + offset, FACES), truth=(SQUARE + offset, FACES), out=out
    )
    page = page_of(out)
    manifest = json.loads(page.texts["manifest"])
    assert (manifest["faces"], manifest["vertices"]) == (2, 4)
    assert page.array("faces", "<u4").reshape(-1, 3).tolist() == FACES.tolist()
    middle, radius = np.array([0.5, 0.5, 0.5]), np.sqrt(0.75)
    for name, vertices in (("before", SQUARE), ("after", LIFTED)):
        got = page.array(f"positions-{name}", "<f4").reshape(-1, 3)
        assert np.allclose(got * radius + middle, vertices, atol=1e-6)
    layers = {layer["name"]: layer for layer in manifest["layers"]}
    values = page.array("angle-before", "<u2") / 65534 * layers["angle"]["top"]
    assert values == pytest.approx([TURN, 0.0], abs=0.002)
    assert page.array("error-before", "<u2").tolist() == [0, 0]
    assert page.array("error-after", "<u2").tolist() == [65534, 0]
    assert page.array("displacement-before", "<u2").tolist() == [0, 65534, 0, 0]
    # Values of the pair stand in the page once.
    assert "angle-after" not in page.texts
    assert "displacement-after" not in page.texts


def test_the_page_fetches_nothing(out: Path) -> None:
    gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), out=out)
    page = page_of(out)
    assert page.links == ["data:,"]
    assert page.policy.startswith("default-src 'none'; ")
    assert "http" not in page.policy
    text = out.read_text(encoding="utf-8")
    assert not re.search(
        r"@import|\bimport\s*\(|url\(", "".join(re.findall(r"<style>.*?</style>", text, re.S))
    )


def test_meshes_without_a_file_are_called_by_their_place(out: Path) -> None:
    gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), out=out)
    text = out.read_text(encoding="utf-8")
    assert 'id="tag-before">before</p>' in text
    assert 'id="tag-after">after</p>' in text


def test_without_truth_there_is_no_error_to_choose(out: Path) -> None:
    gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), out=out)
    assert re.findall(r'<option value="(\w*)"', out.read_text()) == ["", "angle", "displacement", "z", "y"]
    gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), truth=(SQUARE, FACES), out=out)
    assert re.findall(r'<option value="(\w*)"', out.read_text()) == [
        "",
        "angle",
        "error",
        "displacement",
        "z",
        "y",
    ]


def test_names_cannot_break_out_of_the_page(tmp_path: Path, out: Path) -> None:
    name = "</script><b>&$title.ply"
    paths = [tmp_path / folder for folder in ("a", "b")]
    for path, vertices in zip(paths, (LIFTED, SQUARE), strict=True):
        path.mkdir()
        save((vertices, FACES), path / "x.ply")
    from gcnd.mesh_io import to_arrays

    before, after = (to_arrays(path / "x.ply")[0] for path in paths)
    layers, figures = compare_meshes(before, after, before)
    text = view_page(before, after, layers, figures, Names(name, name, name))
    assert "<b>" not in text
    assert json.loads(Page(text).texts["manifest"])["after"] == name
    assert text.count("&lt;/script&gt;&lt;b&gt;&amp;$title.ply") == 7


def test_colors_are_those_of_viridis() -> None:
    from matplotlib import colormaps

    script = files("gcnd.viewer").joinpath("scripts", "colors.js").read_text()
    stops = np.array(
        [[int(s[i : i + 2], 16) for i in (0, 2, 4)] for s in re.findall('"#([0-9a-f]{6})"', script)]
    )
    assert len(stops) == 33
    at = np.linspace(0, 1, 256)
    drawn = np.stack([np.interp(at, np.linspace(0, 1, 33), channel) for channel in stops.T], axis=1)
    assert np.abs(drawn - colormaps["viridis"](at)[:, :3] * 255).max() < 2


def test_three_is_what_its_notice_says() -> None:
    import hashlib

    folder = files("gcnd.viewer").joinpath("three")
    digest = hashlib.sha256(folder.joinpath("three.min.js").read_bytes()).hexdigest()
    assert f"{digest}  three.min.js" in folder.joinpath("NOTICE").read_text()
    assert "Permission is hereby granted, free of charge" in folder.joinpath("LICENSE").read_text()
    assert len(folder.joinpath("three.min.js").read_bytes()) < 1_300_000


# --- what it refuses ---------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["after", "truth"])
def test_other_faces_are_refused(out: Path, which: str) -> None:
    def view(mesh: Any) -> None:
        meshes = {"after": (LIFTED, FACES), "truth": None} | {which: mesh}
        gcnd.view(meshes["after"], against=(SQUARE, FACES), truth=meshes["truth"], out=out)

    with pytest.raises(MeshError, match=rf"^{which} has 1 faces and before has 2$") as told:
        view((SQUARE, FACES[:1]))
    assert "PLY" in str(told.value.hint)
    with pytest.raises(MeshError, match=rf"^face 1 is \(2, 3, 0\) in {which} and \(0, 2, 3\) in before$"):
        view((SQUARE, [[0, 1, 2], [2, 3, 0]]))
    with pytest.raises(MeshError, match=rf"^{which} has 5 vertices and before has 4$"):
        view((np.vstack([SQUARE, SQUARE[:1]]), FACES))
    assert not out.exists()


def test_too_many_faces_are_refused(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert view_module.MAX_FACES == 2_000_000
    monkeypatch.setattr(view_module, "MAX_FACES", 1)
    with pytest.raises(MeshError, match="before has 2 faces, and a page takes at most 1") as told:
        gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), out=out)
    assert told.value.hint is not None
    assert not out.exists()
    monkeypatch.setattr(view_module, "MAX_FACES", 2)
    assert gcnd.view((LIFTED, FACES), against=(SQUARE, FACES), out=out).faces == 2


def test_only_pages_are_written(tmp_path: Path) -> None:
    mesh = tmp_path / "noisy.ply"
    save((SQUARE, FACES), mesh)
    before = mesh.read_bytes()
    with pytest.raises(ConfigError, match=r"noisy\.ply is not the name of a page"):
        gcnd.view((LIFTED, FACES), against=mesh, out=mesh)
    assert mesh.read_bytes() == before
    with pytest.raises(GcndError, match="does not exist"):
        gcnd.view((LIFTED, FACES), against=mesh, out=tmp_path / "no" / "view.html")
