"""SIGKILL at random moments of a folder run and of training; `scripts/kill.py` does it more often."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gcnd.formats.atomic import replacing, write_atomic

SCRIPT = Path(__file__).parents[2] / "scripts" / "kill.py"

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is of POSIX systems")


@pytest.mark.parametrize(("kind", "kills"), [("folder", 4), ("training", 3)])
def test_what_was_killed_goes_on_to_the_same_result(kind: str, kills: int) -> None:
    # In a process of its own: what is doubled must have no threads.
    done = subprocess.run(
        [sys.executable, str(SCRIPT), kind, "--kills", str(kills), "--seed", "7"],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["kills"] >= kills


def test_what_a_kill_left_is_removed_by_the_next_write(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    code = (
        "import os, sys, signal; from gcnd.formats.atomic import replacing\n"
        "with replacing(sys.argv[1]) as partial: partial.write_bytes(b'half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".a.ply.")
    with replacing(tmp_path / "b.ply") as partial:
        partial.write_bytes(b"b")
    assert left.exists(), "it belongs to another file"
    with replacing(path) as other:  # somebody writes the same file at this moment
        other.write_bytes(b"slow")
        write_atomic(path, b"whole")
        assert other.exists(), "its writer lives"
        assert path.read_bytes() == b"whole"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.ply", "b.ply"]
    assert path.read_bytes() == b"slow"


def test_a_long_name_of_wide_letters_can_be_written(tmp_path: Path) -> None:
    path = tmp_path / ("網" * 80 + ".ply")
    write_atomic(path, b"whole")
    assert [entry.read_bytes() for entry in tmp_path.iterdir()] == [b"whole"]
