"""A folder on a local Ray cluster: a worker killed while it is at work, and what is left of Ray after a run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
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


# --- what is left ------------------------------------------------------------------------------------


def processes_of(mark: str) -> list[str]:
    """Names of the processes that inherited a mark in their environment, however their parents ended."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit() and mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "comm").read_text().strip())
        except OSError:  # it has ended, or is somebody else's
            continue
    return found


def start_on_ray(folder: Path, out: Path, address: str) -> subprocess.Popen[str]:
    command = ["denoise", str(folder), str(out), "--ray", "--method", "l0"]
    environment = {**os.environ, "RAY_ADDRESS": address, "GCND_TEST_RUN": str(out)}
    return subprocess.Popen(
        [sys.executable, "-m", "gcnd", *command], stderr=subprocess.PIPE, text=True, env=environment
    )


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="no list of processes")
@pytest.mark.parametrize(
    ("moment", "name"),
    [("start", "SIGINT"), ("work", "SIGINT"), ("start", "SIGTERM"), ("work", "SIGTERM"), ("work", "SIGHUP")],
)
def test_a_signal_leaves_no_process_of_ray(tmp_path: Path, moment: str, name: str) -> None:
    (tmp_path / "in").mkdir()
    large = trimesh.creation.icosphere(subdivisions=6)
    for number in range(4):
        save((large.vertices, large.faces), tmp_path / "in" / f"{number}.ply")
    process = start_on_ray(tmp_path / "in", tmp_path / "out", "local")
    assert process.stderr is not None
    mark = f"GCND_TEST_RUN={tmp_path / 'out'}"
    if moment == "work":
        while "0 of 4 done" not in process.stderr.readline():
            assert process.poll() is None
    else:
        while len(processes_of(mark)) < 2:
            assert process.poll() is None
            time.sleep(0.05)
    number = getattr(signal, name)
    process.send_signal(number)
    told = process.communicate(timeout=120)[1]
    assert process.returncode == 128 + number
    assert "Traceback" not in told
    assert "stopped: 0 of 4 results are there" in told
    # Ray's own agents look for their parent every few seconds; left alone they stay for a minute.
    ended = time.monotonic()
    while processes_of(mark) and time.monotonic() - ended < 15.0:
        time.sleep(0.1)
    assert processes_of(mark) == []


def test_a_cluster_that_was_there_goes_on(cluster: None, folder: Path, tmp_path: Path) -> None:
    process = start_on_ray(folder, tmp_path / "out", ray.get_runtime_context().gcs_address)
    told = process.communicate(timeout=120)[1]
    assert "5 done, 0 skipped, 1 failed" in told
    assert ray.get(ray.remote(lambda: 6 * 7).remote(), timeout=60) == 42


def test_results_outlive_the_cluster() -> None:
    program = """
import numpy as np, ray, trimesh
from gcnd import denoise_many
from gcnd.filters import Filter
ball = trimesh.creation.icosphere(subdivisions=6)
pair = (np.array(ball.vertices), np.array(ball.faces))
results = [denoise_many([pair], denoiser=Filter("taubin"), ray=True)[0].denoised.after for _ in range(2)]
assert not ray.is_initialized()
expected = Filter("taubin").run(pair).after
print([bool((result == expected).all()) for result in results])
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "RAY_ADDRESS": "local"},
    )
    assert done.stdout == "[True, True]\n", done.stderr
