"""Files whose names are no UTF-8, or have letters that the terminal has not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import gcnd
from cli_cases import FACES, VERTICES
from gcnd.mesh_io import load, save

BAD = "bad\udcff"
"""As Python has the bytes b"bad\\xff"."""

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")


def run_program(*arguments: str | Path, encoding: str = "utf-8") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gcnd", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        env=os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "1"},
    )


def write_mesh(folder: Path, name: str) -> Path:
    folder.mkdir(exist_ok=True)
    save((VERTICES, FACES), folder / name)
    return folder / name


@pytest.mark.parametrize("is_folder", [True, False])
def test_a_report_names_what_is_no_utf8(tmp_path: Path, is_folder: bool) -> None:
    mesh, report = write_mesh(tmp_path / "in", f"{BAD}.ply"), tmp_path / "report.json"
    paths = (mesh.parent, tmp_path / "out") if is_folder else (mesh, tmp_path / "out.ply")
    done = run_program("denoise", *paths, "--method", "taubin", "--report", report, "--json")
    assert (done.returncode, "Traceback" in done.stderr) == (0, False)
    told = json.loads(report.read_bytes())
    assert (told[0]["name"] if is_folder else Path(told["input"]).name) == f"{BAD}.ply"
    printed = json.loads(done.stdout)
    assert (printed["files"][0]["name"] if is_folder else Path(printed["input"]).name) == f"{BAD}.ply"


def test_a_page_about_meshes_of_such_names(tmp_path: Path) -> None:
    mesh, out = write_mesh(tmp_path, f"{BAD}.ply"), tmp_path / "view.html"
    gcnd.view(mesh, against=mesh, out=out)
    assert r"<title>bad\udcff.ply against bad\udcff.ply</title>" in out.read_text(encoding="utf-8")


def test_a_material_of_a_mesh_of_such_a_name(tmp_path: Path) -> None:
    texture = trimesh.visual.texture.SimpleMaterial(image=None, diffuse=[255, 0, 0, 255])
    uv = np.zeros((len(VERTICES), 2))
    visual = trimesh.visual.TextureVisuals(uv=uv, material=texture)
    save(trimesh.Trimesh(VERTICES, FACES, visual=visual, process=False), tmp_path / f"{BAD}.obj")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad_.mtl", f"{BAD}.obj"]
    assert load(tmp_path / f"{BAD}.obj").visual.material.diffuse.tolist() == [255, 0, 0, 255]


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_terminal_without_the_letters_gets_escapes(tmp_path: Path, encoding: str) -> None:
    mesh = write_mesh(tmp_path / "in", "网格.ply")
    options = ["--method", "taubin", "--json", "--overwrite"]
    for paths in ((mesh.parent, tmp_path / "out"), (mesh, tmp_path / "网.ply")):
        done = run_program("denoise", *paths, *options, encoding=encoding)
        assert (done.returncode, "Traceback" in done.stderr) == (0, False)
        printed = json.loads(done.stdout)
        name = printed["files"][0]["name"] if "files" in printed else Path(printed["input"]).name
        assert name == "网格.ply"
    (mesh.parent / "牛.ply").write_bytes(b"ply\n")
    done = run_program("denoise", mesh.parent, tmp_path / "out", *options[:2], encoding=encoding)
    assert done.returncode == 1
    assert r"failed" in done.stderr
    assert r"\u725b.ply" in done.stderr
    assert "Traceback" not in done.stderr


def test_what_is_printed_has_escapes_too(tmp_path: Path) -> None:
    run = tmp_path / "网"
    run.mkdir()
    line = {"time": 1.0, "stage": 1, "step": 100, "loss": 0.5, "patches_per_second": 1000.0}
    (run / "log.jsonl").write_text(json.dumps(line) + "\n")
    done = run_program("train-report", run, encoding="cp1252")
    assert (done.returncode, done.stdout.strip()) == (0, f"{tmp_path}/\\u7f51/report.html")
