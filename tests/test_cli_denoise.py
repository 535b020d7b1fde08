"""`gcnd denoise` of one mesh: options, what is printed where, confidence and report; folders are in test_many.py."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import VERTICES
from gcnd.cli import main
from gcnd.controls import Controls
from gcnd.mesh_io import load


def test_denoise_passes_every_option_on(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = mesh_path.with_name("out.obj")
    options = ["--preset", "paper", "--device", "cuda", "--seed", "7"]
    options += ["--normal-iterations", "4", "--vertex-iterations", "3", "--strength", "0.5"]
    options += ["--max-displacement", "0.2", "--max-displacement-edges", "3", "--keep", "region"]
    options += ["--preserve-volume"]
    assert main(["denoise", str(mesh_path), str(out), *options]) == 0
    (call,) = denoise_calls
    assert np.array_equal(call.pop("mesh").vertices, VERTICES)
    assert call == {
        "preset": "paper",
        "device": "cuda",
        "seed": 7,
        "normal_iterations": 4,
        "vertex_iterations": 3,
        "strength": 0.5,
        "max_displacement": 0.2,
        "max_displacement_edges": 3.0,
        "keep": "region",
        "preserve_volume": True,
    }
    assert np.array_equal(load(out).vertices, VERTICES + 1.0)
    printed = capsys.readouterr()
    assert printed.out == ""
    stages = printed.err.splitlines()
    assert stages[:2] == ["normals, pass 1 of 2 (0% done)", "[bold] 2 (50% done)"]
    assert stages[2].startswith(f"wrote {out}: 4 faces in ")


def test_denoise_defaults(mesh_path: Path, denoise_calls: list[dict[str, Any]]) -> None:
    assert main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply"))]) == 0
    (call,) = denoise_calls
    assert (call["preset"], call["device"], call["seed"]) == ("auto", "cpu", 0)
    assert (call["normal_iterations"], call["vertex_iterations"]) == (None, None)
    assert {name: call[name] for name in Controls().described()} == Controls().described()


def test_quiet_prints_nothing(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply")), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert len(denoise_calls) == 1


def test_denoise_json_is_all_of_stdout(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = mesh_path.with_name("out.ply")
    assert main(["denoise", str(mesh_path), str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report.pop("seconds") >= 0.0
    assert report == {
        "input": str(mesh_path),
        "output": str(out),
        "vertices": 4,
        "faces": 4,
        "preset": "default",
        "device": "cpu",
        "seed": 0,
    }
    assert len(denoise_calls) == 1


def test_bad_output_is_told_before_any_work(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    before = mesh_path.read_bytes()
    for out, message in [
        (str(mesh_path), "is the input itself"),
        (str(mesh_path.with_suffix(".fbx")), "unknown mesh format '.fbx'"),
        (str(mesh_path.parent / "no" / "out.ply"), "does not exist"),
    ]:
        assert main(["denoise", str(mesh_path), out]) == 1
        printed = capsys.readouterr()
        assert printed.out == ""
        error, blank, hint = printed.err.splitlines()
        assert error.startswith("error: ")
        assert message in error
        assert blank == ""
        assert hint.startswith("hint: ")
    assert denoise_calls == []
    assert mesh_path.read_bytes() == before


@pytest.mark.parametrize("command", [["denoise"], ["noise", "--level", "0.1"]])
def test_a_format_that_is_not_read_is_the_inputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    source = tmp_path / "in.gltf"
    source.write_text("{}")
    for out in ("out.gltf", "out.ply"):
        assert main([command[0], str(source), str(tmp_path / out), *command[1:]]) == 1
        error, _, hint = capsys.readouterr().err.splitlines()
        assert error == f"error: {source}: unknown mesh format '.gltf'"
        assert hint.endswith("export it again as .glb, which is glTF in one file")


def test_terminal_gets_a_bar(
    mesh_path: Path,
    denoise_calls: list[dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply"))]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "[bold] 2" in printed.err
    assert "50%" in printed.err
    assert "(50% done)" not in printed.err
    assert len(denoise_calls) == 1


# --- confidence and report ----------------------------------------------------------------------------


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
