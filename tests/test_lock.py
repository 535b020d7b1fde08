"""One run at a time in a folder: the second is refused, and a killed one holds nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from compare_cases import write_meshes
from gcnd.cli import main
from gcnd.errors import ConfigError
from gcnd.formats.lock import only_writer

HOLD = """
import sys
from pathlib import Path
from gcnd.formats.lock import only_writer
with only_writer(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def held_by_another(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds a folder until it is told to end."""
    command = [sys.executable, "-c", HOLD, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        yield other
        other.kill()


@pytest.mark.parametrize("writes", [False, True])
def test_a_folder_that_was_made_for_nothing_goes_again(tmp_path: Path, writes: bool) -> None:
    folder = tmp_path / "deep" / "run"

    def fail() -> None:
        with only_writer(folder):
            if writes:
                (folder / "log.jsonl").touch()
            raise ConfigError("odd")

    with pytest.raises(ConfigError, match="odd"):
        fail()
    assert folder.exists() == writes
    folder.mkdir(exist_ok=True)
    with pytest.raises(ConfigError, match="odd"):
        fail()
    assert folder.is_dir()


def test_a_folder_is_made_and_free_again_afterwards(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    for _ in range(2):
        with only_writer(folder):
            assert folder.is_dir()


def test_it_is_free_again_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError), only_writer(tmp_path):
        raise KeyError
    with only_writer(tmp_path):
        pass


def test_a_second_run_is_refused_until_the_first_is_killed(tmp_path: Path) -> None:
    with held_by_another(tmp_path) as other:
        with pytest.raises(ConfigError, match="another run is writing to") as caught, only_writer(tmp_path):
            pass
        assert caught.value.hint == "wait until it has ended, or choose another folder"
        other.kill()
        other.wait()
        with only_writer(tmp_path):
            pass


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="everything can be written to")
def test_a_folder_that_cannot_be_written_to_is_told(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ConfigError, match="cannot write to"), only_writer(tmp_path):
        pass


def test_a_file_in_the_place_of_the_folder_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write to"), only_writer(tmp_path / "file" / "below"):
        pass


@pytest.mark.parametrize("command", ["compare", "train"])
def test_two_runs_into_one_folder_do_not_mix(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = write_meshes(tmp_path / "data", "smooth/ball.ply"), tmp_path / "out"
    arguments = {
        "compare": ["compare", str(data), "--out", str(out), "--methods", "taubin"],
        "train": ["train", "--preset", "fast", "--meshes", str(data), "--out", str(out)],
    }
    with held_by_another(out):
        before = sorted(out.iterdir())
        assert main(arguments[command]) == 1
        assert f"another run is writing to {out}" in capsys.readouterr().err
        assert sorted(out.iterdir()) == before
