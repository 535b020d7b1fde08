"""The command line as a program: how errors are told, how it exits, what it imports; commands are in test_cli_*.py."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cli_cases import FakeDenoiser, stand_in
from gcnd.cli import main
from gcnd.errors import ConfigError, GcndError


def run_program(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gcnd", *arguments], capture_output=True, text=True, timeout=120, **options
    )


# --- errors ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raised", "code", "told"),
    [
        (
            ConfigError("no preset 'x'", hint="see gcnd models"),
            1,
            "error: no preset 'x'\n\nhint: see gcnd models\n",
        ),
        (GcndError("odd"), 1, "error: odd\n"),
        (
            OSError(errno.ENOSPC, "No space left on device", "/data/a"),
            1,
            "error: /data/a: No space left on device\n\n"
            "hint: free some space, or write elsewhere; what stood there is as it was\n",
        ),
        (OSError("bare"), 1, "error: bare\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_errors_are_told_without_a_traceback(
    mesh_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    raised: BaseException,
    code: int,
    told: str,
) -> None:
    stand_in(monkeypatch, "gcnd.denoiser", Denoiser=type("Fake", (FakeDenoiser,), {"raised": raised}))
    out = mesh_path.with_name("out.ply")
    assert main(["denoise", str(mesh_path), str(out), "--quiet"]) == code
    assert capsys.readouterr() == ("", told)
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["denoise"],
        ["denoise", "a.ply", "b.ply", "--device", "tpu"],
        ["denoise", "a.ply", "b.ply", "--vertex-iterations", "-1"],
        ["denoise", "a.ply", "b.ply", "--strength", "1.1"],
        ["denoise", "a.ply", "b.ply", "--max-displacement", "-1"],
        ["noise", "a.ply", "b.ply"],
        ["noise", "a.ply", "b.ply", "--level", "-0.1"],
        ["noise", "a.ply", "b.ply", "--level", "0.1", "--fraction", "1.5"],
        ["evaluate", "a.ply", "b.ply", "--samples", "0"],
        ["train", "--threads", "0"],
        ["frobnicate"],
        ["--frobnicate"],
    ],
)
def test_wrong_command_lines_exit_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Usage: gcnd" in printed.err


def test_no_arguments_show_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("denoise", "noise", "evaluate", "info", "models", "--version"))


def test_brackets_in_the_help_are_no_markup(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["denoise", "--help"]) == 0
    assert "gcnd[ray]" in capsys.readouterr().out


# --- the program -------------------------------------------------------------------------------------


def test_program_tells_a_missing_file(tmp_path: Path) -> None:
    done = run_program("info", str(tmp_path / "missing.ply"))
    assert done.returncode == 1
    assert done.stdout == ""
    error, _, hint = done.stderr.splitlines()
    assert error == f"error: no such file: {tmp_path / 'missing.ply'}"
    assert hint.startswith("hint: ")


def test_version() -> None:
    done = run_program("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("gcnd ")


def test_commands_import_nothing_heavy_until_they_run() -> None:
    code = (
        "import sys; import gcnd; before = set(sys.modules); import gcnd.cli; "
        "print({'torch', 'trimesh', 'scipy', 'numpy', 'gcnd.mesh_io'} & (set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "set()\n"


@pytest.mark.skipif(os.name == "nt", reason="no such shell")
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_error(mesh_path: Path, tmp_path: Path, closed: str) -> None:
    out = tmp_path / "out.ply"
    command = f'"$0" -m gcnd denoise "$1" "$2" --method taubin {closed}'
    done = subprocess.run(
        ["sh", "-c", command, sys.executable, str(mesh_path), str(out)], check=False, timeout=120
    )
    assert done.returncode == 0
    assert out.is_file()


@pytest.mark.skipif(os.name == "nt", reason="no such pipes")
@pytest.mark.parametrize("is_unbuffered", [False, True])
def test_reader_that_went_away_is_no_error(mesh_path: Path, is_unbuffered: bool) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1" if is_unbuffered else ""}
    done = subprocess.run(
        [sys.executable, "-m", "gcnd", "info", str(mesh_path)],
        stdout=write_end,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
        env=environment,
    )
    os.close(write_end)
    assert done.stderr == ""
    assert done.returncode == 1
