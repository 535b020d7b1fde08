"""One method on one mesh in a process of its own: what came back, or why nothing did."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from gcnd.compare.adapters.base import Faces, Vertices
    from gcnd.compare.methods import Method

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "RAYON_NUM_THREADS",
    "VTK_SMP_MAX_THREADS",
)


@dataclass(frozen=True)
class Outcome:
    """What one run gave.

    Attributes:
        vertices: Positions (V, 3) in the order of the input, finite; None when the run failed.
        error: Why it failed, in a line; None when it did not.
        seconds: Of the method alone: without start-up, imports and the reading of weights.
        peak_mib: Most memory that the process held, MiB; None where the system does not say.
        added_mib: Of it, what came on top of what it held before the method began.
    """

    vertices: Vertices | None
    error: str | None
    seconds: float | None = None
    peak_mib: float | None = None
    added_mib: float | None = None


def run_in_child(
    method: Method, vertices: Vertices, faces: Faces, *, threads: int, timeout: float
) -> Outcome:
    """Runs a method in a process of its own, bound to some processors and ended after some time.

    Args:
        method: What to run.
        vertices: Noisy positions (V, 3).
        faces: Vertex ids (F, 3).
        threads: Processors that it may use.
        timeout: Seconds until it is ended, start-up included.

    Returns:
        The result; whatever goes wrong in the process, a crash of it included, is its ``error``.
    """
    with _job_folder() as folder:
        job = {"entry": method.entry, "settings": dict(method.settings), "threads": threads}
        (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        np.savez(folder / "input.npz", vertices=vertices, faces=faces)
        failure = _wait(folder, threads, timeout)
        if failure is not None:
            return Outcome(None, failure)
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        if "error" in report:
            return Outcome(None, report["error"])
        return _checked(folder / "output.npz", vertices, faces, report)


@contextmanager
def _job_folder() -> Iterator[Path]:
    """A folder for as long as the block runs, which a signal does not leave behind, whenever it comes."""
    folder = None
    try:
        with _signals_put_off():
            folder = Path(tempfile.mkdtemp(prefix="gcnd-compare-"))
        yield folder
    finally:
        if folder is not None:
            _remove(folder)


def _remove(folder: Path) -> None:
    try:
        shutil.rmtree(folder)
    except BaseException:
        # Ctrl-C while the files are removed, as a rule; what is raised is what there is to tell.
        shutil.rmtree(folder, ignore_errors=True)
        raise


@contextmanager
def _signals_put_off() -> Iterator[None]:
    """Has signals wait while the block makes a folder or process: before it has a name nobody would tidy it up."""
    before, came = {}, []
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and callable(signal.getsignal(number)):
                before[number] = signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


def _wait(folder: Path, threads: int, timeout: float) -> str | None:
    """Runs the worker to its end; returns why it left no report, or None."""
    environment = os.environ | dict.fromkeys(_THREAD_VARIABLES, str(threads))
    command = [sys.executable, "-m", "gcnd.compare.worker", str(folder)]
    process = None
    try:
        with (folder / "log.txt").open("wb") as log, _signals_put_off():
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                # Signals are the parent's to handle: it ends the child and keeps the rows.
                start_new_session=True,
            )
        process.wait(timeout)
    except subprocess.TimeoutExpired:
        return f"took longer than {timeout:g} s"
    finally:
        if process is not None:
            _end(process)
    if (folder / "report.json").exists():
        return None
    lines = (folder / "log.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines()
    last = f": {lines[-1].strip()}" if lines else ""
    return f"{_ending(process.returncode)}{last}"


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        with suppress(ProcessLookupError, PermissionError):
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
        process.wait()
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()


def _ending(code: int) -> str:
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return f"crashed with {name}" + (" (out of memory?)" if name == "SIGKILL" else "")
    return f"ended with exit code {code}"


def _checked(path: Path, vertices: Vertices, faces: Faces, report: dict[str, Any]) -> Outcome:
    """The result, if it is one: the same vertices and faces in the same order, every position finite."""
    with np.load(path, allow_pickle=False) as file:
        moved, kept = file["vertices"], file["faces"]
    error = None
    if moved.shape != vertices.shape:
        error = f"returned {len(moved)} vertices for {len(vertices)}: order and count are lost"
    elif kept.shape != faces.shape:
        error = f"returned {len(kept)} faces for {len(faces)}"
    elif not np.array_equal(_from_smallest(kept), _from_smallest(faces)):
        face_id = int(np.any(_from_smallest(kept) != _from_smallest(faces), axis=1).argmax())
        error = f"face {face_id} is {kept[face_id].tolist()}, was {faces[face_id].tolist()}: order is lost"
    else:
        bad = ~np.isfinite(moved).all(axis=1)
        if bad.any():
            error = (
                f"{int(bad.sum())} of {len(moved)} positions are not finite, first vertex {int(bad.argmax())}"
            )
    numbers = {name: report[name] for name in ("seconds", "peak_mib", "added_mib")}
    return Outcome(None if error else moved.astype(np.float64), error, **numbers)


def _from_smallest(faces: Faces) -> Faces:
    """Each face's ids turned until the smallest comes first: some libraries begin a face at another corner."""
    turned = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turned, axis=1)
