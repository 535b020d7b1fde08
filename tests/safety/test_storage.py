"""Full disks, folders that cannot be written to, two runs at once: told clearly, nothing half-written, input kept."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from gcnd.cli import main
from gcnd.errors import GcndError
from gcnd.filters import Filter
from gcnd.many import Outcome, denoise_many
from gcnd.mesh_io import SUPPORTED, load, save
from gcnd.weights.files import load_tensors, save_tensors

BALL = trimesh.creation.icosphere(subdivisions=4)


def contents(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


@pytest.fixture
def home(tmp_path: Path) -> Path:
    save(BALL, tmp_path / "in.ply")
    return tmp_path


def denoise(home: Path, out: Path, *options: str) -> int:
    return main(["denoise", str(home / "in.ply"), str(out), "-q", "--method", "laplacian", *options])


@pytest.mark.parametrize(
    ("code", "hint"),
    [
        (errno.ENOSPC, "hint: free some space"),
        (errno.EDQUOT, "hint: your quota is used up"),
        (errno.EROFS, "hint: it is mounted read-only"),
        (errno.EACCES, "hint: choose another folder"),
    ],
)
@pytest.mark.parametrize("extension", SUPPORTED)
def test_a_failed_write_is_told_with_what_to_do(
    home: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    code: int,
    hint: str,
    extension: str,
) -> None:
    old = home / f"out{extension}"
    old.write_bytes(b"precious")
    before = contents(home)

    def fail(_: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fail)
    assert denoise(home, old) == 1
    printed = capsys.readouterr().err
    assert f"cannot write {old}: {os.strerror(code)}" in printed
    assert hint in printed
    assert "Traceback" not in printed
    assert contents(home) == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 KiB, where one may be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no mount")
    if done.returncode:
        pytest.skip("no file system can be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk(home: Path, small_disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (small_disk / "out.ply").write_bytes(b"precious")
    before = (home / "in.ply").read_bytes()
    assert len(before) > 64 * 1024
    assert denoise(home, small_disk / "out.ply") == 1
    assert "No space left on device" in capsys.readouterr().err
    assert contents(small_disk) == {"out.ply": b"precious"}
    with pytest.raises(Exception, match=r"No space left|I/O error"):
        save_tensors(small_disk / "w.safetensors", {"w": torch.ones(1 << 16)}, {})
    assert contents(small_disk) == {"out.ply": b"precious"}
    assert (home / "in.ply").read_bytes() == before


@pytest.mark.skipif(sys.platform == "win32", reason="limits of resources are of POSIX systems")
def test_a_file_beyond_the_limit_on_sizes(home: Path) -> None:
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192));"
        "from gcnd.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    (home / "out.ply").write_bytes(b"precious")
    before = contents(home)
    command = [sys.executable, "-c", code, "denoise", str(home / "in.ply"), str(home / "out.ply"), "-q"]
    done = subprocess.run([*command, "--method", "laplacian"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "File too large" in done.stderr
    assert "hint: the file is larger than" in done.stderr
    assert contents(home) == before


def test_a_folder_run_on_a_full_disk_tells_each_and_goes_on_later(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = home / "many"
    given.mkdir()
    for name in ("a.ply", "b.obj", "c.stl"):
        save(BALL, given / name)
    before = contents(given)
    with monkeypatch.context() as patched:
        sizes = iter([0, 1, 1])

        def fail_later(_: int) -> None:
            if next(sizes):
                raise OSError(errno.ENOSPC, "No space left on device")

        patched.setattr(os, "fsync", fail_later)
        outcomes = denoise_many(given, home / "out", denoiser=Filter("laplacian"))
    assert [outcome.status for outcome in outcomes] == ["done", "failed", "failed"]
    assert all("No space left" in str(outcome.error) for outcome in outcomes[1:])
    assert list(contents(home / "out")) == ["a.ply"]
    again = denoise_many(given, home / "out", denoiser=Filter("laplacian"))
    assert [outcome.status for outcome in again] == ["skipped", "done", "done"]
    assert contents(given) == before


def test_a_folder_that_cannot_be_made_is_told_of_each_file(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "mkdir", fail)
    (outcome,) = denoise_many(home, home / "out", denoiser=Filter("laplacian"))
    assert outcome.status == "failed"
    assert isinstance(outcome.error, GcndError)
    assert str(outcome.error) == f"cannot make the folder {home / 'out'}: Read-only file system"
    assert outcome.error.hint == "it is mounted read-only: write elsewhere"


def test_a_page_that_cannot_be_written_leaves_the_old(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = home / "view.html"
    page.write_text("precious")
    before = contents(home)

    def fail(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    given = str(home / "in.ply")
    assert main(["view", given, "--against", given, "--out", str(page)]) == 1
    told = capsys.readouterr().err
    assert f"cannot write {page}: No space left on device" in told
    assert "hint: free some space" in told
    assert contents(home) == before


def test_two_runs_into_one_folder_at_once(home: Path) -> None:
    given = home / "many"
    given.mkdir()
    for number in range(6):
        save((np.array(BALL.vertices) * (1 + number), BALL.faces), given / f"{number}.ply")
    straight = denoise_many(given, home / "straight", denoiser=Filter("laplacian"))
    assert {outcome.status for outcome in straight} == {"done"}
    found: list[list[Outcome]] = []
    ready = threading.Barrier(2)

    def run() -> None:
        ready.wait()
        found.append(denoise_many(given, home / "out", denoiser=Filter("laplacian")))

    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 2
    assert {outcome.status for outcomes in found for outcome in outcomes} <= {"done", "skipped"}
    assert contents(home / "out") == contents(home / "straight")


def test_weights_that_cannot_be_written_leave_the_old(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "w.safetensors"
    save_tensors(path, {"w": torch.ones(3)}, {"old": True})

    def fail(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gcnd.formats.atomic.os.fsync", fail)
    with pytest.raises(OSError, match="No space left"):
        save_tensors(path, {"w": torch.zeros(3)}, {})
    assert load_tensors(path)[1] == {"old": True}
    assert [entry.name for entry in tmp_path.iterdir()] == ["w.safetensors"]


def test_a_device_is_no_mesh(tmp_path: Path) -> None:
    if not Path("/dev/zero").exists():
        pytest.skip("there is no /dev/zero")
    (tmp_path / "endless.ply").symlink_to("/dev/zero")
    with pytest.raises(ValueError, match="is no regular file"):
        load(tmp_path / "endless.ply")
