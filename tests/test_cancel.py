"""Stopping a run: by its callback and by Ctrl-C, soon, with nothing half-written and no thread left.

The limits are three times what is promised, for machines with much to do besides; benches/cancel.py measures.
"""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import gcnd.predict
from gcnd import Cancelled, ConfigError, Controls, Denoiser, _geom
from gcnd.cli import interrupt, main
from gcnd.cli.interrupt import check_interrupted, noticing_ctrl_c
from gcnd.cli.progress import show_progress
from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.filters import Filter, apply_filter
from gcnd.mesh_io import save

PROMISED, MARGIN = 0.5, 3.0


def wave(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A wavy sheet of 2 n² faces with noise."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0)))
    vertices = np.stack([x, y, 2.0 * np.sin(x / 9.0) * np.cos(y / 7.0)], axis=1)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    a, b, c, d = corner, corner + 1, corner + n + 1, corner + n + 2
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]).astype(np.uint32)
    return add_noise(vertices, faces, level=0.2, seed=0), faces


@pytest.fixture(scope="module")
def large() -> tuple[np.ndarray, np.ndarray]:
    return wave(224)


@pytest.mark.parametrize("delay", [0.02, 0.4, 1.0])
def test_a_run_stops_soon_and_leaves_no_thread(large: Any, delay: float) -> None:
    assert len(large[1]) > 100_000
    denoiser = Denoiser("default")
    wish: list[float] = []
    before, vertices = threading.active_count(), large[0].copy()
    timer = threading.Timer(delay, lambda: wish.append(time.perf_counter()))
    timer.start()
    with pytest.raises(Cancelled):
        denoiser.run(large, progress=lambda *_: not wish)
    taken = time.perf_counter() - wish[0]
    timer.join()
    assert threading.active_count() == before
    assert taken < MARGIN * PROMISED
    assert np.array_equal(large[0], vertices)


def test_a_filter_stops_soon(large: Any) -> None:
    wish: list[float] = []
    timer = threading.Timer(0.3, lambda: wish.append(time.perf_counter()))
    timer.start()
    with pytest.raises(Cancelled, match="guided-normal"):
        Filter("guided-normal", normal_iterations=1000).run(large, progress=lambda *_: not wish)
    assert time.perf_counter() - wish[0] < MARGIN * PROMISED


def test_batches_are_told_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = []
    for nodes in (1 << 7, 1 << 12):
        monkeypatch.setitem(gcnd.predict.PATCH_NODES_A_BATCH, "cpu", nodes)
        calls: list[float] = []
        Denoiser("fast").run(wave(60), progress=lambda fraction, _, calls=calls: calls.append(fraction))
        assert calls == sorted(calls)
        counts.append(len(calls))
    assert counts[0] > 3 * counts[1]


def test_ctrl_c_while_threads_start_leaves_none(monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(threading.Barrier):
        def wait(self, timeout: float | None = None) -> int:
            if threading.current_thread() is threading.main_thread():
                raise KeyboardInterrupt
            return super().wait(timeout)

    monkeypatch.setattr(gcnd.predict, "Barrier", Interrupted)
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        Denoiser("fast").run(wave(10))
    assert threading.active_count() == before


# --- what cannot be told -------------------------------------------------------------------------------

BALL = (np.eye(4, 3), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.mark.parametrize("progress", [3, "yes", True, []])
@pytest.mark.parametrize(
    "call",
    [
        lambda progress: gcnd.denoise(BALL, preset="none", progress=progress),
        lambda progress: Denoiser("fast")(BALL, progress=progress),
        lambda progress: Denoiser("fast").run(BALL, progress=progress),
        lambda progress: gcnd.denoise_many([BALL], denoiser=Filter("taubin"), progress=progress),
        lambda progress: Filter("taubin").run(BALL, progress=progress),
        lambda progress: apply_filter(BALL, "taubin", progress=progress),
        lambda progress: denoise_arrays(*BALL, None, progress=progress),  # type: ignore[arg-type]
    ],
    ids=[
        "denoise",
        "Denoiser",
        "Denoiser.run",
        "denoise_many",
        "Filter.run",
        "apply_filter",
        "denoise_arrays",
    ],
)
def test_progress_that_cannot_be_called_is_told_before_anything_else(
    call: Callable[[Any], Any], progress: Any
) -> None:
    with pytest.raises(ConfigError) as error:
        call(progress)
    assert str(error.value) == f"progress is {progress!r}, allowed: a function, or None"


# --- the program -------------------------------------------------------------------------------------


@pytest.mark.skipif(os.name == "nt", reason="signals of another kind")
@pytest.mark.parametrize(
    ("moment", "name"),
    [("import", "SIGINT"), ("normals", "SIGINT"), ("normals", "SIGTERM"), ("normals", "SIGHUP")],
)
def test_a_signal_ends_the_program_soon_and_leaves_nothing(
    large: Any, tmp_path: Path, moment: str, name: str
) -> None:
    source = tmp_path / "in.ply"
    save(large, source)
    command = [sys.executable, "-m", "gcnd", "denoise", str(source), str(tmp_path / "out.ply")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    if moment == "normals":
        while "normals" not in process.stderr.readline():
            assert process.poll() is None
    time.sleep(1.0)
    started = time.perf_counter()
    number = getattr(signal, name)
    process.send_signal(number)
    told = process.communicate(timeout=60)[1]
    assert time.perf_counter() - started < MARGIN * PROMISED
    # Where there is nothing to lose, the signal itself ends the process; a shell calls that 130 as well.
    assert process.returncode in ((128 + number, -number) if moment == "import" else (128 + number,))
    assert moment == "import" or "Traceback" not in told
    assert [path.name for path in tmp_path.iterdir()] == ["in.ply"]


def test_ctrl_c_that_a_library_swallows_is_noticed() -> None:
    with noticing_ctrl_c(), show_progress(quiet=True) as progress:
        progress(0.0, "before")
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException as error:
            swallowed = type(error)
        assert swallowed is KeyboardInterrupt
        with pytest.raises(KeyboardInterrupt):
            progress(0.1, "after")
    with noticing_ctrl_c():
        check_interrupted()  # of this block there was none


@pytest.mark.skipif(os.name == "nt", reason="signals of another kind")
def test_a_signal_that_ends_is_taken_once_and_in_a_process_of_its_own_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    numbers = (signal.SIGTERM, signal.SIGHUP)
    with interrupt.tidying_up():
        assert [signal.getsignal(number) for number in numbers] == [signal.SIG_DFL] * 2
    monkeypatch.setattr(interrupt, "_owns_process", threading.Event())
    interrupt.own_process()
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    try:
        with interrupt.tidying_up(), show_progress(quiet=True) as progress:
            signal.raise_signal(signal.SIGHUP)
            with pytest.raises(interrupt.Ended) as ended:
                signal.raise_signal(signal.SIGTERM)
            assert ended.value.exit_code == 143
            signal.raise_signal(signal.SIGTERM)  # a second one does not stop the tidying
            with pytest.raises(interrupt.Ended):  # and who swallows the first is told again
                progress(0.5, "after")
        assert [signal.getsignal(number) for number in numbers] == [signal.SIG_DFL, signal.SIG_IGN]
        with interrupt.tidying_up():
            check_interrupted()  # of this block there was none
    finally:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_the_callers_handler_comes_back(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    assert main(["info", str(tmp_path / "none.ply")]) == 1
    assert signal.getsignal(signal.SIGINT) is before
    with interrupt.nothing_to_lose():  # not in a process of somebody else's
        assert signal.getsignal(signal.SIGINT) is before


def test_the_command_line_runs_in_any_thread(tmp_path: Path) -> None:
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(main(["info", str(tmp_path / "none.ply")])))
    thread.start()
    thread.join()
    assert codes == [1]


# --- how often is asked ------------------------------------------------------------------------------


class Enough(Exception):
    """What a callback raises to stop."""


def core_work(mesh: tuple[np.ndarray, np.ndarray]) -> dict[str, tuple[Callable[..., Any], int]]:
    """The core's longest calls by name, each with the steps after which it asks."""
    vertices, faces = mesh
    topology = _geom.Topology(faces, len(vertices))
    normals = _geom.face_geometry(vertices, faces)[0]
    spread = np.full(len(faces), 0.01)
    consistent = functools.partial(
        _geom.refine_consistent, topology, vertices, normals, spread, iterations=12, tolerance=3.0
    )
    return {
        "extractor": (functools.partial(_geom.PatchExtractor, topology, vertices, scale_space=True), 2 + 16),
        "refine": (
            functools.partial(_geom.refine_normals, topology, vertices, normals, iterations=12),
            1 + 12,
        ),
        "consistent": (consistent, 1 + 12 + 2 * 20),
        "update": (functools.partial(_geom.update_vertices, topology, vertices, normals, 15), 15),
        "fit": (functools.partial(_geom.fit_vertices, topology, vertices, normals, vertices), 30),
    }


@pytest.mark.parametrize("name", ["extractor", "refine", "consistent", "update", "fit"])
def test_the_core_asks_between_its_steps_and_does_none_after_a_no(name: str) -> None:
    work, n_steps = core_work(wave(20))[name]
    for last in (1, n_steps // 2, n_steps):
        told: list[tuple[int, int]] = []

        def progress(step: int, total: int, told: list[tuple[int, int]] = told, last: int = last) -> None:
            told.append((step, total))
            if step == last:
                raise Enough

        with pytest.raises(Enough):
            work(progress=progress)
        assert told == [(step, n_steps) for step in range(1, last + 1)]


def test_a_run_stops_at_any_moment_and_asks_nothing_after_it() -> None:
    mesh = wave(16)
    denoiser = Denoiser()
    stages: list[str] = []
    expected = denoiser.run(mesh, progress=lambda _, stage: stages.append(stage)).after
    for last in (*range(1, len(stages), len(stages) // 14), len(stages)):
        asked: list[str] = []

        def until(_: float, stage: str, asked: list[str] = asked, last: int = last) -> bool:
            asked.append(stage)
            return len(asked) < last

        with pytest.raises(Cancelled):
            denoiser.run(mesh, progress=until)
        assert asked == stages[:last]
    assert np.array_equal(denoiser.run(mesh).after, expected)


def test_finishing_asks_between_its_steps_and_does_none_after_a_no() -> None:
    chosen = Filter("taubin", controls=Controls(preserve_volume=True, max_displacement_edges=0.1))
    ball = trimesh.creation.icosphere(subdivisions=3)
    noisy = add_noise(np.array(ball.vertices), ball.faces.astype(np.uint32), level=0.3, seed=1)
    asked: Counter[str] = Counter()
    chosen.run((noisy, ball.faces), progress=lambda _, stage: asked.update([stage]))
    n_steps = asked["finishing"]
    assert n_steps > 30
    for last in (2, n_steps // 2, n_steps):
        told: Counter[str] = Counter()

        def until(_: float, stage: str, told: Counter[str] = told, last: int = last) -> bool:
            told.update([stage])
            return told["finishing"] < last

        with pytest.raises(Cancelled, match="finishing"):
            chosen.run((noisy, ball.faces), progress=until)
        assert told["finishing"] == last


def test_every_long_stage_of_a_run_asks_many_times() -> None:
    asked: Counter[str] = Counter()
    Denoiser().run(wave(24), progress=lambda _, stage: asked.update([stage]))
    assert asked["preset"] >= 4
    (*passes, last) = [count for stage, count in asked.items() if stage.startswith("vertices")]
    # Updates after every pass, and the rounds of refinement at the last.
    assert all(count >= 15 for count in passes)
    assert last >= 15 + 40
    # The tree and the scale space, besides the batches of patches.
    assert all(count > 18 for stage, count in asked.items() if stage.startswith("normals"))
