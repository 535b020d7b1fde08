"""`gcnd denoise`: confidence and report of one mesh; folders are in test_many.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import VERTICES
from gcnd.cli import main
from gcnd.mesh_io import load


def test_confidence_becomes_a_face_attribute(mesh_path: Path, denoise_calls: list[dict[str, Any]]) -> None:
    out = mesh_path.with_name("out.ply")
    assert main(["denoise", str(mesh_path), str(out), "-q", "--confidence"]) == 0
    assert denoise_calls[0]["confidence"] is True
    written = load(out)
    assert written.face_attributes["confidence"].dtype == np.float32
    assert np.array_equal(written.face_attributes["confidence"], np.linspace(0, 1, 4, dtype=np.float32))
    assert np.array_equal(written.vertices, VERTICES + 1.0)
    assert main(["denoise", str(mesh_path), str(out), "-q"]) == 0
    assert "confidence" not in load(out).face_attributes


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("out.stl", [], "only .ply holds a confidence by face"),
        ("out.ply", ["--method", "taubin"], "--confidence is for presets"),
    ],
)
def test_confidence_without_a_place_or_a_network(
    mesh_path: Path,
    denoise_calls: list[dict[str, Any]],
    capsys: pytest.CaptureFixture[str],
    name: str,
    options: list[str],
    message: str,
) -> None:
    out = mesh_path.with_name(name)
    assert main(["denoise", str(mesh_path), str(out), "--confidence", *options]) == 1
    assert message in capsys.readouterr().err
    assert denoise_calls == []
    assert not out.exists()


def test_the_report_of_a_preset(mesh_path: Path, denoise_calls: list[dict[str, Any]]) -> None:
    report = mesh_path.with_name("report.json")
    assert (
        main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply")), "-q", "--report", str(report)])
        == 0
    )
    found = json.loads(report.read_text())
    assert found["displacement"]["mean"] == pytest.approx(3**0.5)
    assert found["seconds"]["normals"] == 0.25
    assert found["seconds"]["writing"] > 0
    assert found["seconds"]["loading"] > 0
    assert found["method"] == {"preset": "default"}
    assert len(denoise_calls) == 1


@pytest.mark.parametrize("options", [[], ["--overwrite"]])
def test_a_single_result_is_always_written_anew(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], options: list[str]
) -> None:
    """A folder's results are skipped where they are there; of one mesh, `--overwrite` says what is done anyway."""
    out = mesh_path.with_name("out.ply")
    out.write_text("an older result, newer than its input")
    assert main(["denoise", str(mesh_path), str(out), "-q", *options]) == 0
    assert np.array_equal(load(out).vertices, VERTICES + 1.0)
    assert len(denoise_calls) == 1


def obj_with_materials(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "my mat.mtl").write_text("newmtl red\nmap_Kd wood.png\n")
    (folder / "wood.png").write_bytes(b"wood")
    rows = [f"v {x} {y} {z}" for x, y, z in VERTICES.tolist()]
    path = folder / "t.obj"
    path.write_text(
        "\n".join(["mtllib my mat.mtl", *rows, "usemtl red", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"])
    )
    return path


@pytest.mark.parametrize("name", ["my mat.mtl", "wood.png", "out/my mat.mtl", "out/wood.png", "out/t.mtl"])
def test_a_report_in_the_place_of_a_material_is_refused(
    tmp_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], name: str
) -> None:
    source = obj_with_materials(tmp_path)
    (tmp_path / "out").mkdir()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    out, report = tmp_path / "out" / "t.obj", tmp_path / name
    assert main(["denoise", str(source), str(out), "--report", str(report)]) == 1
    assert f"{report} is the input itself, or another file of this run" in capsys.readouterr().err
    assert denoise_calls == []
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before


@pytest.mark.parametrize("blocked", ["my mat.mtl", "wood.png"])
@pytest.mark.parametrize("whole_folder", [False, True])
def test_another_file_of_a_material_s_name_is_told_before_the_work(
    tmp_path: Path,
    denoise_calls: list[dict[str, Any]],
    capsys: pytest.CaptureFixture[str],
    blocked: str,
    whole_folder: bool,
) -> None:
    source = obj_with_materials(tmp_path / "in")
    out = tmp_path / "out" / "t.obj"
    out.parent.mkdir()
    (out.parent / blocked).write_text("other")
    paths = (source.parent, out.parent) if whole_folder else (source, out)
    assert main(["denoise", *map(str, paths)]) == 1
    told = capsys.readouterr().err
    assert (
        f"cannot write {out}: it refers to {blocked}, and {out.parent / blocked} is another file than" in told
    )
    assert "cannot read" not in told
    assert denoise_calls == []
    assert [path.name for path in out.parent.iterdir()] == [blocked]
