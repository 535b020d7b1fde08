"""Runs in child processes: failures are rows, a stopped run goes on, and times and memory are the method's alone."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import compare_cases as given
from compare_cases import Case, ball, case, method
from gcnd.compare.child import Outcome, run_in_child
from gcnd.compare.measures import measure
from gcnd.compare.methods import Method, parse_methods
from gcnd.compare.report import draw_pictures
from gcnd.compare.rows import INPUT
from gcnd.compare.run import Conditions, available_threads, check_output_folder, compare, load_result
from gcnd.errors import ConfigError
from gcnd.filters import apply_filter

ONE = Conditions(threads=1, samples=500, timeout=60)
IS_LINUX = os.path.exists("/proc/self/clear_refs")


@pytest.fixture(autouse=True)
def children_find_the_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    known = os.environ.get("PYTHONPATH")
    here = str(Path(__file__).parent)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, *([known] if known else [])]))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = tmp_path / "deep" / "report"
    folder.mkdir(parents=True)
    return folder


def outcome(found: Method, timeout: float = 60) -> Any:
    mesh = ball()
    return run_in_child(found, mesh.noisy, mesh.faces, threads=1, timeout=timeout)


def test_a_filter_in_a_child_gives_what_it_gives_here() -> None:
    mesh = ball()
    (found,) = parse_methods(["guided-normal[sigma_r=0.2]"])
    result = outcome(found)
    expected = apply_filter((mesh.noisy, mesh.faces), "guided-normal", sigma_r=0.2)[0]
    assert result.error is None
    assert np.array_equal(result.vertices, expected)


@pytest.mark.parametrize("function", [given.slow_start, given.first_call_slow])
def test_start_up_is_not_timed(function: Any) -> None:
    result = outcome(method(function, pause=1.0))
    assert result.error is None
    assert 0 <= result.seconds < 0.9


@pytest.mark.skipif(not IS_LINUX, reason="other systems do not let a process forget its peak")
def test_memory_is_what_the_method_held() -> None:
    result = outcome(method(given.holding, mebibytes=200))
    assert 190 < result.added_mib < 240
    assert result.peak_mib > result.added_mib
    assert outcome(method(given.same)).added_mib < 20


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="threads are bound on Linux only")
def test_a_method_gets_the_processors_it_was_given() -> None:
    assert outcome(method(given.processors)).vertices[0].tolist() == [1, 1, 0]


def test_faces_that_begin_at_another_corner_keep_their_order() -> None:
    assert outcome(method(given.turned)).error is None


@pytest.mark.parametrize(
    ("function", "error"),
    [
        (given.not_finite, "2 of 162 positions are not finite, first vertex 3"),
        (given.one_more, "returned 163 vertices for 162: order and count are lost"),
        (given.faces_lost, "returned 319 faces for 320"),
        (given.reordered, r"face 0 is \[.*\], was \[.*\]: order is lost"),
        (given.raising, "ValueError: no such vertex"),
        (given.crashing, "crashed with SIGSEGV: a last word"),
    ],
)
def test_what_goes_wrong_is_told_in_a_line(function: Any, error: str) -> None:
    result = outcome(method(function))
    assert result.vertices is None
    assert result.error is not None
    assert re.fullmatch(error, result.error)


def test_a_method_that_takes_too_long_is_ended() -> None:
    assert outcome(method(given.endless), timeout=5).error == "took longer than 5 s"


def test_a_child_ends_with_its_parent_alone_and_removes_its_folder(tmp_path: Path) -> None:
    folder, begun = tmp_path / "job", tmp_path / "begun"
    folder.mkdir()
    job = {"entry": "compare_cases:announced", "settings": {"path": str(begun)}, "threads": 1}
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    mesh = ball()
    np.savez(folder / "input.npz", vertices=mesh.noisy, faces=mesh.faces)
    command = [sys.executable, "-m", "gcnd.compare.worker", str(folder)]
    child = subprocess.Popen(command, stdin=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while not begun.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    if os.name != "nt":
        child.send_signal(signal.SIGTERM)
        child.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(1)
    assert child.stdin is not None
    child.stdin.close()
    assert child.wait(30) == 1
    assert not folder.exists()


@pytest.mark.skipif(os.name == "nt", reason="Windows ends processes without a signal")
def test_a_signal_while_the_process_is_made_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[subprocess.Popen[bytes]] = []

    class Interrupted(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            made.append(self)
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr("gcnd.compare.child.subprocess.Popen", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        outcome(method(given.endless))
    assert [process.returncode for process in made] == [-signal.SIGKILL]
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_while_files_are_removed_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    remove, calls = shutil.rmtree, []

    def interrupted(folder: Path, **options: Any) -> None:
        calls.append(folder)
        if len(calls) == 1:
            raise KeyboardInterrupt
        remove(folder, **options)

    monkeypatch.setattr("gcnd.compare.child.shutil.rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt):
        outcome(method(given.same))
    assert len(calls) == 2
    assert list(tmp_path.iterdir()) == []


def test_rows_of_a_comparison(out: Path) -> None:
    methods = [method(given.moved, by=0.01), method(given.not_finite)]
    noisy, shifted, failed = compare([case()], methods, out, ONE)
    mesh = ball()
    expected = measure(mesh.noisy + 0.01, mesh.truth, mesh.faces, samples=500)
    assert (noisy.method, noisy.source, noisy.seconds) == (INPUT, "input", None)
    assert noisy.e_a == pytest.approx(measure(mesh.noisy, mesh.truth, mesh.faces, samples=500).e_a)
    assert (shifted.mesh, shifted.noise, shifted.level, shifted.faces) == ("ball", "gaussian", "0.2", 320)
    assert {name: getattr(shifted, name) for name in vars(expected)} == vars(expected)
    assert shifted.error is None
    assert np.allclose(load_result(out, shifted), mesh.noisy + 0.01, atol=1e-6)
    assert failed.error == "2 of 162 positions are not finite, first vertex 3"
    assert (failed.e_a, failed.seconds, load_result(out, failed)) == (None, None, None)
    lines = [json.loads(line) for line in (out / "rows.jsonl").read_text(encoding="utf-8").splitlines()]
    assert [line["method"] for line in lines] == [INPUT, "moved", "not_finite"]


class Stopped(BaseException):
    """Stands for Ctrl-C."""


def test_a_stopped_run_goes_on_where_it_was(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [case("a", 0.1), case("b", 0.2)]
    methods = [method(given.same), method(given.raising)]

    def stop(fraction: float, label: str) -> None:
        if label.startswith("b") and label.endswith("raising"):
            raise Stopped

    with pytest.raises(Stopped):
        compare(cases, methods, out, ONE, progress=stop)
    path = out / "rows.jsonl"
    kept = path.read_bytes()
    assert kept.count(b"\n") == 5
    path.write_bytes(kept + b'{"key": "cut sho')
    ran: list[tuple[str, int]] = []
    run = run_in_child

    def counted(found: Method, *arrays: Any, **options: Any) -> Any:
        ran.append((found.label, len(ran)))
        return run(found, *arrays, **options)

    monkeypatch.setattr("gcnd.compare.run.run_in_child", counted)
    rows = compare(cases, methods, out, ONE)
    assert ran == [("raising", 0)]
    assert path.read_bytes().startswith(kept)
    assert [(row.mesh, row.method, row.error is None) for row in rows] == [
        ("a", INPUT, True),
        ("a", "same", True),
        ("a", "raising", False),
        ("b", INPUT, True),
        ("b", "same", True),
        ("b", "raising", False),
    ]
    before = path.read_bytes()
    assert compare(cases, methods, out, ONE) == rows
    assert path.read_bytes() == before


def test_whatever_changes_what_is_run_is_run_again(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []

    def counted(found: Method, vertices: Any, *arrays: Any, **options: Any) -> Any:
        ran.append(found.label)
        return given_outcome(vertices)

    monkeypatch.setattr("gcnd.compare.run.run_in_child", counted)

    def runs(cases: list[Case], found: Method, conditions: Conditions = ONE) -> int:
        ran.clear()
        compare(cases, [found], out, conditions)
        return len(ran)

    base = method(given.moved, by=0.5)
    assert runs([case()], base) == 1
    assert runs([case()], base) == 0
    assert runs([case()], replace(base, label="another name")) == 0
    assert runs([case()], method(given.moved, by=0.25)) == 1
    assert runs([case()], method(given.moved, "2", by=0.5)) == 1
    assert runs([case(level=0.3)], base) == 1
    assert runs([case()], base, replace(ONE, samples=501)) == 1


def given_outcome(vertices: Any) -> Any:
    return Outcome(vertices, None, 0.5, 10.0, 1.0)


def test_failed_rows_are_run_again_when_asked(out: Path) -> None:
    failing = [method(given.raising)]
    compare([case()], failing, out, ONE)
    compare([case()], failing, out, ONE)
    assert (out / "rows.jsonl").read_bytes().count(b"\n") == 2
    compare([case()], failing, out, replace(ONE, retry_failed=True))
    assert (out / "rows.jsonl").read_bytes().count(b"\n") == 3


def test_a_damaged_line_in_the_middle_is_named(out: Path) -> None:
    compare([case()], [method(given.raising)], out, ONE)
    path = out / "rows.jsonl"
    path.write_bytes(b"{half\n" + path.read_bytes())
    with pytest.raises(ConfigError, match=r"line 1 of .* is damaged") as caught:
        compare([case()], [method(given.raising)], out, ONE)
    assert caught.value.hint == "remove the line; its run is then done again"


@pytest.mark.parametrize(
    ("name", "value"),
    [("e_a", "x"), ("e_a", True), ("mesh", None), ("flipped", 1.5), ("faces", 0), ("settings", [])],
)
def test_a_row_with_a_value_of_another_kind_is_damaged(out: Path, name: str, value: Any) -> None:
    compare([case()], [], out, ONE)
    path = out / "rows.jsonl"
    line = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(line) + "\n" + json.dumps({**line, name: value}) + "\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"line 2 of .* is damaged"):
        compare([case()], [], out, ONE)


@pytest.mark.parametrize("kind", ["text", "cut", "npy", "other arrays", "other mesh"])
def test_a_result_that_cannot_be_read_has_no_picture(out: Path, kind: str) -> None:
    (_, row) = rows = compare([case()], [method(given.same)], out, ONE)
    path = out / "results" / f"{row.key}.npz"
    if kind == "text":
        path.write_text("no archive")
    elif kind == "cut":
        path.write_bytes(path.read_bytes()[:-400])
    elif kind == "npy":
        with path.open("wb") as file:
            np.save(file, ball().noisy)
    else:
        vertices = ball().noisy[:-1]
        np.savez(path, **{"vertices" if kind == "other mesh" else "faces": vertices})
    assert (load_result(out, row) is None) == (kind != "other mesh")
    ((_, pictures),) = draw_pictures([case()], rows, out, "one")
    assert [shot.title for shot in pictures.shots] == ["noisy", "truth"]


def test_conditions_and_folders_out_of_range_are_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for make, message in (
        (lambda: Conditions(threads=0), "threads is 0, allowed: 1 to"),
        (lambda: Conditions(threads=available_threads() + 1), "threads is"),
        (lambda: Conditions(threads=1, timeout=0), "timeout is 0, allowed"),
        (lambda: Conditions(threads=1, samples=0), "samples is 0, allowed"),
        (lambda: check_output_folder(tmp_path / "file"), "is a file, not a folder"),
        (lambda: check_output_folder(tmp_path / "file" / "below"), "cannot make"),
    ):
        with pytest.raises(ConfigError, match=message):
            make()
    check_output_folder(tmp_path / "not" / "there" / "yet")
    assert not (tmp_path / "not").exists()
