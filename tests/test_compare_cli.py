"""`gcnd compare` from the command line: a whole run, its end by Ctrl-C, and what it refuses."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from compare_cases import ball, write_meshes
from gcnd.cli import main
from gcnd.mesh_io import save

QUICK = ["--levels", "0.2", "--samples", "500", "--threads", "1", "--pictures", "none"]


def test_a_whole_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = write_meshes(tmp_path / "data", "smooth/ball.ply"), tmp_path / "out"
    arguments = ["compare", str(data), "--out", str(out), "--methods", "taubin,laplacian", *QUICK]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[1] == "noise: gaussian, means over all meshes"
    assert lines[2].split()[:5] == ["method", "runs", "E_a", "at", "0.2"]
    names = [line.split()[0] for line in lines[3:]]
    assert names[0] == "noisy"
    assert {*names} == {"noisy", "best", "taubin", "laplacian"}
    table = {line.split()[0]: line.split() for line in lines[3:]}
    summary = {
        line["method"]: line
        for line in json.loads((out / "results.json").read_text(encoding="utf-8"))["summary"]
        if (line["kind"], line["level"]) == ("all", "all")
    }
    assert float(table["taubin"][2]) == pytest.approx(summary["taubin"]["e_a"], abs=0.006)
    assert summary["taubin"]["e_a"] < summary["noisy"]["e_a"]
    assert printed.err.splitlines()[0] == "smooth/ball, gaussian 0.2: taubin (0% done)"
    assert printed.err.splitlines()[-1] == f"wrote {out / 'report.html'}, results.csv and results.json"
    rows = (out / "rows.jsonl").read_bytes()
    assert main([*arguments, "--json", "--quiet"]) == 0
    printed = capsys.readouterr()
    assert {line["method"] for line in json.loads(printed.out)} >= {"noisy", "taubin"}
    assert printed.err == ""
    assert (out / "rows.jsonl").read_bytes() == rows


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send")
def test_ctrl_c_keeps_rows_and_ends_with_130(tmp_path: Path) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out"
    methods = ",".join(f"taubin[iterations={n}]" for n in range(1, 60))
    command = [
        sys.executable,
        "-m",
        "gcnd",
        "compare",
        str(data),
        "--out",
        str(out),
        "--methods",
        methods,
    ]
    process = subprocess.Popen([*command, *QUICK], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    rows = out / "rows.jsonl"
    deadline = time.monotonic() + 100
    while not (rows.exists() and rows.read_bytes().count(b"\n") >= 3) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert errors.splitlines()[-1] == f"stopped: finished rows are in {out}, and the same command goes on"
    kept = [json.loads(line)["method"] for line in rows.read_text(encoding="utf-8").splitlines()]
    assert kept[:3] == ["noisy", "taubin[iterations=1]", "taubin[iterations=2]"]
    assert len(kept) < 60
    assert not (out / "report.html").exists()


def children_of(parent: int) -> list[int]:
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended by now
            # The name in the second field, in brackets, may hold anything.
            fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
            if int(fields[1]) == parent:
                found.append(int(folder.name))
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds processes in /proc")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGKILL"])
def test_a_signal_leaves_nothing_behind_and_the_same_command_goes_on(tmp_path: Path, name: str) -> None:
    data, out, temporary = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out", tmp_path / "temporary"
    temporary.mkdir()
    # The second takes seconds, in which the signal comes.
    methods = ["--methods", "taubin,l0[mu_beta=1.001],laplacian"]
    arguments = ["compare", str(data), "--out", str(out), *methods, *QUICK]
    process = subprocess.Popen(
        [sys.executable, "-m", "gcnd", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(temporary)},
    )
    rows, running, deadline = out / "rows.jsonl", [], time.monotonic() + 100
    while time.monotonic() < deadline and not running:
        time.sleep(0.02)
        if rows.exists() and rows.read_bytes().count(b"\n") == 2 and list(temporary.glob("*/input.npz")):
            running = children_of(process.pid)
    assert running
    process.send_signal(getattr(signal, name))
    errors = process.communicate(timeout=60)[1]
    number = int(getattr(signal, name))
    assert process.returncode == (-number if name == "SIGKILL" else 128 + number)
    assert "Traceback" not in errors
    if name == "SIGKILL":  # what is left is the child's to end and to remove
        while time.monotonic() < deadline and (
            list(temporary.iterdir()) or Path(f"/proc/{running[0]}").exists()
        ):
            time.sleep(0.02)
    else:
        told = f"stopped: finished rows are in {out}, and the same command goes on"
        assert errors.splitlines()[-1] == told
    assert list(temporary.iterdir()) == []
    assert not [child for child in running if Path(f"/proc/{child}").exists()]
    kept = rows.read_bytes()
    assert [json.loads(line)["method"] for line in kept.splitlines()] == ["noisy", "taubin"]
    assert main([*arguments, "--quiet"]) == 0
    whole = rows.read_bytes()
    assert whole.startswith(kept)
    assert [json.loads(line)["error"] for line in whole.splitlines()] == [None] * 4


def test_bad_input_is_told_without_a_traceback(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out"
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    mesh = ball()
    for part, faces in (("noisy", mesh.faces), ("original", np.roll(mesh.faces, 1, axis=0))):
        (tmp_path / "pairs" / part).mkdir(parents=True)
        save((mesh.truth, faces), tmp_path / "pairs" / part / "a.ply")
    good = [str(data), "--out", str(out)]
    for arguments, message, hint in (
        ([*good, "--methods", "l1"], "there is no method 'l1'", "bilateral-normal"),
        ([*good, "--levels", "low"], "levels is 'low', allowed: numbers", ""),
        ([*good, "--threads", "0"], "threads is 0, allowed: 1 to", "hint: this machine"),
        ([*good, "--noise", "salt"], "unknown noise 'salt'", "hint: kinds are gaussian"),
        ([str(data), "--out", str(tmp_path / "file")], "is a file, not a folder", "hint: give --out"),
        ([str(tmp_path / "empty"), "--out", str(out)], "no mesh in", "hint: supported: .ply"),
        ([str(tmp_path / "nowhere"), "--out", str(out)], "no such folder", "or builtin"),
        ([str(tmp_path / "pairs"), "--out", str(out)], "differ in face 0", "hint: both need the same faces"),
    ):
        assert main(["compare", *QUICK, *arguments]) == 1
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.startswith("error: ")
        assert message in printed.err
        assert hint in printed.err
        assert "Traceback" not in printed.err
        assert not out.exists()


@pytest.mark.skipif(os.name == "nt", reason="links need a right there")
@pytest.mark.parametrize("name", ["rows.jsonl", "results.csv", "results.json", "report.html"])
def test_nothing_that_is_written_replaces_a_mesh(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out"
    before = (data / "a.ply").read_bytes()
    out.mkdir()
    (out / name).symlink_to(data / "a.ply")
    assert main(["compare", str(data), "--out", str(out), "--methods", "taubin", *QUICK]) == 1
    assert f"{name} is the input itself" in capsys.readouterr().err
    assert (data / "a.ply").read_bytes() == before


def test_missing_libraries_are_skipped_with_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out"
    monkeypatch.setattr(
        "gcnd.compare.methods._missing", lambda library: "not here" if library.name == "meshlib" else None
    )
    arguments = ["compare", str(data), "--out", str(out), *QUICK, "--quiet", "--methods"]
    assert main([*arguments, "meshlib:denoise,taubin"]) == 0
    printed = capsys.readouterr()
    assert printed.err == "skipped meshlib:denoise: not here\n"
    assert "taubin" in printed.out
    assert "skipped meshlib:denoise: not here" in (out / "report.html").read_text(encoding="utf-8")
    assert main([*arguments, "meshlib"]) == 1
    assert "error: no method is left to compare" in capsys.readouterr().err


def test_failures_are_told_with_their_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply", "b.ply"), tmp_path / "out"
    methods = ["--methods", "taubin[lambda=1,mu=-2,iterations=99],laplacian"]
    assert main(["compare", str(data), "--out", str(out), *QUICK, "--quiet", *methods]) == 0
    printed = capsys.readouterr()
    assert re.fullmatch(
        r"failed: taubin\[lambda=1,mu=-2,iterations=99\], a, gaussian 0.2 and 1 more: "
        r"GcndError: the filter diverged in iteration \d+; the input is unchanged\n",
        printed.err,
    )
    assert "0/2" in printed.out


def test_settings_out_of_range_are_told_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out"
    for methods, message in (
        ("taubin[lambda=2]", "lambda"),
        ("laplacian[lambda=nan]", "lambda is nan, allowed: a number"),
        ("trimesh:humphrey[alpha=inf]", "alpha is inf, allowed: a number"),
        ("laplacian[lambda=0.5,lambda=0.2]", "laplacian is given lambda twice"),
    ):
        assert main(["compare", str(data), "--out", str(out), "--methods", methods, *QUICK]) == 1
        assert message in capsys.readouterr().err
    for option, value in (("--timeout", "inf"), ("--samples", "100000000")):
        assert main(["compare", str(data), "--out", str(out), *QUICK, option, value]) == 1
        assert f"{option[2:]} is" in capsys.readouterr().err
    assert not out.exists()


def test_it_fails_where_no_method_gave_a_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out"
    arguments = ["compare", str(data), "--out", str(out), "--methods", "l0", "--timeout", "0.001", *QUICK]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert "no method gave a result" in printed.err
    assert (out / "report.html").exists()


def test_levels_that_differ_in_late_digits_are_apart(tmp_path: Path) -> None:
    data, out = write_meshes(tmp_path / "data", "a.ply"), tmp_path / "out"
    levels = ["--levels", "0.1234567,0.1234568", *QUICK[2:]]
    assert main(["compare", str(data), "--out", str(out), "--methods", "laplacian", *levels]) == 0
    rows = json.loads((out / "results.json").read_text(encoding="utf-8"))["rows"]
    assert {row["level"] for row in rows} == {"0.1234567", "0.1234568"}


def test_pairs_with_one_name_are_refused_and_their_noise_is_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, data, out = ball(), tmp_path / "data", tmp_path / "out"
    for part, name in (("original", "a.ply"), ("noisy", "a_n1.ply"), ("noisy", "a_n1.off")):
        (data / part).mkdir(parents=True, exist_ok=True)
        save((mesh.truth if part == "original" else mesh.noisy, mesh.faces), data / part / name)
    arguments = ["compare", str(data), "--out", str(out), "--methods", "laplacian", *QUICK]
    assert main(arguments) == 1
    assert "2 noisy meshes are called a, n1" in capsys.readouterr().err
    (data / "noisy" / "a_n1.off").unlink()
    assert main(arguments) == 0
    assert "--noise, --levels, --fraction and --seed are not for pairs" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="names of files are Unicode there")
def test_names_that_are_not_utf_8_are_written_with_their_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = tmp_path / os.fsdecode(b"data\xff"), tmp_path / "out"
    write_meshes(data, os.fsdecode(b"kind\xfe/b\xff.ply"))
    methods = ["--methods", "laplacian", "--pictures", "one"]
    arguments = ["compare", str(data), "--out", str(out), *QUICK, *methods]
    assert main(arguments) == 0
    mesh, kind = r"kind\xfe/b\xff", r"kind\xfe"
    assert f"{mesh}, gaussian 0.2: laplacian" in capsys.readouterr().err
    rows = json.loads((out / "results.json").read_text(encoding="utf-8"))["rows"]
    assert {(row["mesh"], row["kind"]) for row in rows} == {(mesh, kind)}
    assert [row["error"] for row in rows] == [None] * 2
    assert mesh in (out / "results.csv").read_text(encoding="utf-8")
    assert mesh in (out / "report.html").read_text(encoding="utf-8")
    kept = (out / "rows.jsonl").read_bytes()
    assert main([*arguments, "--quiet"]) == 0
    assert (out / "rows.jsonl").read_bytes() == kept


def test_meshes_that_cannot_be_read_are_rows_and_the_rest_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = write_meshes(tmp_path / "data", "good.ply"), tmp_path / "out"
    (data / "quad.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    (data / "nan.off").write_text("OFF\n3 1 0\nnan 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    (data / "cut.ply").write_bytes((data / "good.ply").read_bytes()[:-100])
    noise = ["--noise", "gaussian,kinect1", *QUICK, "--pictures", "one", "--quiet"]
    arguments = ["compare", str(data), "--out", str(out), "--methods", "laplacian,taubin", *noise]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    told = printed.err.splitlines()
    assert [line.partition(": ")[2].split(",")[1].strip() for line in told] == ["cut", "nan", "quad"]
    assert all(line.startswith("failed: noisy, ") for line in told)
    found = json.loads((out / "results.json").read_text(encoding="utf-8"))
    failed = {row["mesh"]: row for row in found["rows"] if row["error"] is not None}
    assert {*failed} == {"cut", "nan", "quad"}
    assert {(row["method"], row["faces"], row["e_a"]) for row in failed.values()} == {("noisy", 0, None)}
    assert "not finite" in failed["nan"]["error"]
    assert "triangulate" in failed["quad"]["error"]
    runs = {
        (line["method"], line["runs"], line["failed"])
        for line in found["summary"]
        if (line["noise"], line["kind"], line["level"]) == ("gaussian", "all", "all")
    }
    assert {("noisy", 4, 3), ("laplacian", 1, 0), ("taubin", 1, 0)} <= runs
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<p>2 noisy meshes" in page
    assert page.count("<td>quad") == 2
    # What was repaired meanwhile is read again.
    (data / "cut.ply").write_bytes((data / "good.ply").read_bytes())
    assert main(arguments) == 0
    assert "cut" not in capsys.readouterr().err
    (data / "good.ply").unlink()
    (data / "cut.ply").unlink()
    assert main(arguments) == 1
    assert "error: " in capsys.readouterr().err


def test_a_pair_that_does_not_fit_is_a_row_beside_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, data, out = ball(), tmp_path / "data", tmp_path / "out"
    for part in ("original", "noisy"):
        (data / part).mkdir(parents=True)
        for name in ("a.ply", "b.ply"):
            n = len(mesh.faces) - (part == "noisy" and name == "b.ply")
            save((mesh.truth if part == "original" else mesh.noisy, mesh.faces[:n]), data / part / name)
    arguments = ["compare", str(data), "--out", str(out), "--methods", "laplacian", *QUICK, "--quiet"]
    assert main(arguments) == 0
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert printed.startswith("failed: noisy, b, given noisy: ")
    assert "has 319 faces, its truth" in printed
