"""The report of a folder run: what a stopped run leaves of it, which files it never replaces, which settings it has."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gcnd import many
from gcnd.cli import main
from gcnd.filters import list_filters
from gcnd.mesh_io import save

BALL = trimesh.creation.icosphere(subdivisions=2)
NAMES = ["a.ply", "b.ply", "deep/c.off", "d.stl"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in NAMES:
        path = tmp_path / "in" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        save((BALL.vertices, BALL.faces), path)
    return tmp_path / "in"


def run(folder: Path, *options: str) -> int:
    out, report = folder.parent / "out", folder.parent / "report.json"
    return main(
        ["denoise", str(folder), str(out), "--method", "taubin", "-q", "--report", str(report), *options]
    )


def rows_of(folder: Path) -> dict[str, Any]:
    rows = json.loads((folder.parent / "report.json").read_text())
    assert [row["name"] for row in rows] == sorted(NAMES)
    return {row["name"]: row for row in rows}


def stop_at(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes while that mesh is at work."""
    real = many.run_job

    def run_job(job: many.Job, *arguments: Any) -> many.Outcome:
        if job.name == name:
            raise KeyboardInterrupt
        return real(job, *arguments)

    monkeypatch.setattr(many, "run_job", run_job)


# --- Ctrl-C ------------------------------------------------------------------------------------------


def test_a_stopped_run_reports_what_it_did(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        stop_at("d.stl", patch)
        assert run(folder) == 130
    rows = rows_of(folder)
    assert {name: row["status"] for name, row in rows.items()} == {
        "a.ply": "done",
        "b.ply": "done",
        "d.stl": "stopped",
        "deep/c.off": "stopped",
    }
    assert rows["a.ply"]["report"]["method"]["filter"] == "taubin"
    assert rows["d.stl"]["report"] is None
    assert rows["d.stl"]["output"] is None
    stopped = rows["a.ply"]["report"]
    assert run(folder) == 0
    rows = rows_of(folder)
    assert [row["status"] for row in rows.values()] == ["skipped", "skipped", "done", "done"]
    assert rows["a.ply"]["report"] == stopped
    assert all(row["report"] for row in rows.values())


@pytest.mark.parametrize("options", [[], ["--overwrite"]])
def test_a_stopped_run_keeps_the_reports_of_results_that_are_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    assert run(folder) == 0
    before = rows_of(folder)
    (folder.parent / "out" / "b.ply").unlink()
    stop_at("b.ply", monkeypatch)
    assert run(folder, *options) == 130
    rows = rows_of(folder)
    assert rows["a.ply"]["status"] == ("done" if options else "skipped")
    for name in ("d.stl", "deep/c.off"):
        assert rows[name]["status"] == "stopped"
        assert rows[name]["report"] == before[name]["report"]
        assert rows[name]["output"] == before[name]["output"]
    assert rows["b.ply"]["report"] is None
    assert rows["b.ply"]["output"] is None


@pytest.mark.skipif(os.name == "nt", reason="signals of another kind")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_leaves_the_report(folder: Path, name: str) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    for number in range(20):
        save((ball.vertices, ball.faces), folder / f"c{number:02}.ply")
    out, report = folder.parent / "out", folder.parent / "report.json"
    command = ["denoise", str(folder), str(out), "--method", "bilateral-normal", "--report", str(report)]
    process = subprocess.Popen([sys.executable, "-m", "gcnd", *command], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    while "c01.ply" not in process.stderr.readline():
        assert process.poll() is None
    number = getattr(signal, name)
    process.send_signal(number)
    told = process.communicate(timeout=60)[1]
    assert process.returncode == 128 + number
    assert "Traceback" not in told
    stopped, blank, hint = told.splitlines()[-3:]
    assert not list(out.rglob(".*"))
    n_there = sum(path.is_file() for path in out.rglob("*"))
    assert stopped == f"stopped: {n_there} of 24 results are there"
    assert (blank, hint) == ("", "hint: run the same command again; results that are there are skipped")
    statuses = {row["name"]: row["status"] for row in json.loads(report.read_text())}
    assert len(statuses) == 24
    assert [statuses[name] for name in ("a.ply", "b.ply", "c00.ply")] == ["done"] * 3
    assert [statuses[name] for name in ("c19.ply", "d.stl", "deep/c.off")] == ["stopped"] * 3


@pytest.mark.skipif(sys.platform != "linux", reason="terminals of another kind")
def test_a_terminal_that_is_closed_leaves_the_report(folder: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    for number in range(20):
        save((ball.vertices, ball.faces), folder / f"c{number:02}.ply")
    out, report = folder.parent / "out", folder.parent / "report.json"
    command = ["denoise", str(folder), str(out), "--method", "bilateral-normal", "--report", str(report)]
    code = "import os, pty, sys; pid, terminal = pty.fork()\n"
    code += "if pid == 0: os.execv(sys.executable, [sys.executable, '-m', 'gcnd', *sys.argv[1:]])\n"
    code += "seen = b''\nwhile b'c01' not in seen: seen += os.read(terminal, 1000)\n"
    code += "os.close(terminal); print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))"
    # In a process of its own: what is doubled must have no threads.
    done = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True, timeout=120)
    assert done.stdout == f"{128 + signal.SIGHUP}\n", done.stderr
    statuses = {row["name"]: row["status"] for row in json.loads(report.read_text())}
    assert (statuses["c00.ply"], statuses["c19.ply"]) == ("done", "stopped")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([], "results that are there are skipped"),
        (["--overwrite"], "with --overwrite it begins with the first"),
    ],
)
def test_a_stopped_run_says_how_to_go_on(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    told: str,
) -> None:
    command = ["denoise", str(folder), str(folder.parent / "out"), "--method", "taubin", *options]
    with monkeypatch.context() as patch:
        stop_at("d.stl", patch)
        assert main([*command, "--quiet"]) == 130
        assert capsys.readouterr() == ("", "")
        assert main(command) == 130
    *_, stopped, blank, hint = capsys.readouterr().err.splitlines()
    assert (stopped, blank) == ("stopped: 2 of 4 results are there", "")
    assert hint == f"hint: run the same command again; {told}"
    assert main(command) == 0
    counts = "4 done, 0 skipped" if options else "2 done, 2 skipped"
    assert counts in capsys.readouterr().err
    # A result of before that the next run does not come to is there too, but is not made again.
    (folder.parent / "out" / "a.ply").unlink()
    (folder.parent / "out" / "d.stl").unlink()
    with monkeypatch.context() as patch:
        stop_at("d.stl", patch)
        assert main(command) == 130
    n_there = 2 if options else 3
    assert f"stopped: {n_there} of 4 results are there" in capsys.readouterr().err


# --- what it never replaces --------------------------------------------------------------------------


def with_materials(folder: Path) -> None:
    (folder / "e.obj").write_text(
        "\n".join(["mtllib e.mtl", "v 0 0 0", "v 1 0 0", "v 0 1 0", "usemtl red", "f 1 2 3"])
    )
    (folder / "e.mtl").write_text("newmtl red\nmap_Kd skin/wood.png\n")
    (folder / "skin").mkdir()
    (folder / "skin" / "wood.png").write_bytes(b"wood")
    textured = (
        (folder / "a.ply").read_bytes().replace(b"\nelement", b"\ncomment TextureFile stone.png\nelement", 1)
    )
    (folder / "a.ply").write_bytes(textured)
    (folder / "stone.png").write_bytes(b"stone")
    # What is wrong with these is told when their turn comes.
    (folder / "broken.ply").write_bytes(b"ply\nelement vertex -1\nend_header\n")
    header = b'{"images": 3}   '
    (folder / "broken.glb").write_bytes(b"glTF" + bytes(8) + bytes([len(header)]) + bytes(7) + header)


@pytest.mark.parametrize(
    "name",
    [
        "in/e.mtl",
        "in/skin/wood.png",
        "in/stone.png",
        "out/stone.png",
        "out/e.mtl",
        "out/d.stl",
    ],
)
def test_a_report_replaces_no_material_and_no_texture(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    with_materials(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    report = folder.parent / name
    assert run(folder, "--report", str(report)) == 1
    assert f"error: {report} is the input itself, or another file of this run" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()} == before


def test_materials_leave_room_for_a_report(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_materials(folder)
    assert run(folder) == 1
    capsys.readouterr()
    rows = json.loads((folder.parent / "report.json").read_text())
    assert {row["name"] for row in rows if row["status"] == "failed"} == {"broken.ply", "broken.glb"}
    assert (folder.parent / "out" / "skin" / "wood.png").read_bytes() == b"wood"


# --- settings ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_folder", [True, False])
def test_json_has_all_parameters_of_a_filter(
    folder: Path, capsys: pytest.CaptureFixture[str], is_folder: bool
) -> None:
    source = folder if is_folder else folder / "a.ply"
    out = folder.parent / ("out" if is_folder else "out.ply")
    report = folder.parent / "report.json"
    command = [
        "denoise",
        str(source),
        str(out),
        "--method",
        "taubin",
        "-q",
        "--json",
        "--report",
        str(report),
    ]
    assert main([*command, "--param", "lambda=0.4"]) == 0
    shown = json.loads(capsys.readouterr().out)
    parameters = (shown["settings"] if is_folder else shown)["parameters"]
    (info,) = [info for info in list_filters() if info.name == "taubin"]
    assert parameters == info.parameters | {"lambda_": 0.4}
    ran = json.loads(report.read_text())
    for one in [row["report"] for row in ran] if is_folder else [ran]:
        assert one["method"]["parameters"] == parameters
    assert np.isfinite(list(parameters.values())).all()
