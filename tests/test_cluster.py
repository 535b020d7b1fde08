"""A folder on a local Ray cluster of two workers, one of them killed while it is at work."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gcnd import denoise_many
from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.errors import MeshError
from gcnd.filters import Filter
from gcnd.mesh_io import save

ray = pytest.importorskip("ray")

BALL = trimesh.creation.icosphere(subdivisions=1)
FACES = BALL.faces.astype(np.uint32)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    for seed in range(5):
        vertices = add_noise(np.array(BALL.vertices), FACES, level=0.2, seed=seed)
        save((vertices, FACES), tmp_path / "in" / f"{seed}.ply")
    (tmp_path / "in" / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    return tmp_path / "in"


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def told(outcomes: Any) -> list[tuple[str, str, str | None]]:
    return [(o.name, o.status, None if o.error is None else str(o.error)) for o in outcomes]


def test_a_killed_worker_costs_nothing(cluster: None, folder: Path, tmp_path: Path) -> None:
    expected = denoise_many(folder, tmp_path / "alone", denoiser=Filter("taubin"))
    pids = tmp_path / "pids"
    pids.mkdir()

    class Slow:
        """Tells who is at work, and takes its time in whoever comes first."""

        triangulate = False

        def run(self, mesh: Any, *, progress: Any = None) -> Any:
            is_first = not any(pids.iterdir())
            (pids / str(os.getpid())).touch()
            time.sleep(60.0 if is_first else 0.5)
            return Filter("taubin").run(mesh, progress=progress)

    killed: list[int] = []

    def kill() -> None:
        while not killed:
            for path in pids.iterdir():
                os.kill(int(path.name), signal.SIGKILL)
                killed.append(int(path.name))
                break
            time.sleep(0.05)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    found = denoise_many(folder, tmp_path / "out", denoiser=Slow(), ray=True)
    assert len(killed) == 1
    assert told(found) == told(expected)
    assert [outcome.status for outcome in found] == ["done"] * 5 + ["failed"]
    assert isinstance(found[-1].error, MeshError)
    assert found[-1].error.hint == expected[-1].error.hint
    assert contents(tmp_path / "out") == contents(tmp_path / "alone")


def test_the_command_skips_what_is_done(
    cluster: None, folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command = ["denoise", str(folder), str(tmp_path / "out"), "--ray", "--method", "taubin"]
    assert main(command) == 1
    assert "5 done, 0 skipped, 1 failed" in capfd.readouterr().err
    (tmp_path / "out" / "3.ply").unlink()
    assert main(command) == 1
    assert "1 done, 4 skipped, 1 failed" in capfd.readouterr().err
    assert (
        main(["denoise", str(folder / "0.ply"), str(tmp_path / "o.ply"), "--ray", "--method", "taubin"]) == 1
    )
    assert "--ray is for folders" in capfd.readouterr().err
