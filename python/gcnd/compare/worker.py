"""The child process of the comparison: runs one method on one mesh and says how long it took and how much it held.

Run as ``python -m gcnd.compare.worker FOLDER``; what it reads and writes there is `gcnd.compare.child`'s.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

_MIB = 1 / 1024


def main(folder: Path) -> None:
    """Reads ``job.json`` and ``input.npz``, writes ``output.npz`` and ``report.json`` into the same folder."""
    _leave_signals_to_parent()
    threading.Thread(target=_end_with_parent, args=(folder,), daemon=True).start()
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    pin(job["threads"])
    try:
        report = _run(folder, job)
    except Exception as error:  # whatever a method raises is a result of the comparison
        text = " ".join(str(error).split())
        report = {"error": f"{type(error).__name__}: {text}" if text else type(error).__name__}
    (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")


def pin(threads: int) -> None:
    """Binds this process to its first ``threads`` processors, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])


def _run(folder: Path, job: dict[str, Any]) -> dict[str, Any]:
    import numpy as np

    module, _, function = job["entry"].partition(":")
    denoise = getattr(import_module(module), function)(**job["settings"])
    with np.load(folder / "input.npz", allow_pickle=False) as file:
        vertices, faces = file["vertices"], file["faces"]
    _warm_up(denoise)
    before = _resident_mib("VmRSS")
    start_peak = peak_mib()
    _forget_peak()
    started = time.perf_counter()
    moved, kept = denoise(vertices.copy(), faces.copy())
    seconds = time.perf_counter() - started
    peak = peak_mib()
    np.savez(folder / "output.npz", vertices=moved, faces=kept)
    return {
        "seconds": seconds,
        "peak_mib": None if peak is None or start_peak is None else max(start_peak, peak),
        "added_mib": None if peak is None or before is None else max(0.0, peak - before),
    }


def _warm_up(denoise: Any) -> None:
    """Runs a method once on a mesh of 32 faces: what libraries import or build at the first call is start-up."""
    import numpy as np

    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    vertices = np.stack([x.ravel(), y.ravel(), 0.1 * np.sin(3 * x + 5 * y).ravel()], axis=1)
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(half) for half in ((0, 1, 6), (0, 6, 5))]).astype(np.uint32)
    # What a method cannot do with so small a mesh says nothing about it.
    with suppress(Exception):
        denoise(vertices, faces)


def peak_mib() -> float | None:
    """Returns the most memory that this process has held at once, MiB; None where the system does not say."""
    # Not getrusage on Linux: there a child starts with its parent's peak.
    found = _resident_mib("VmHWM")
    if found is not None:
        return found
    try:
        import resource
    except ImportError:
        return None
    per_mib = 1024 * 1024 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / per_mib


def _resident_mib(field: str) -> float | None:
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith(f"{field}:"):
                return int(line.split()[1]) * _MIB
    return None


def _forget_peak() -> None:
    """Lets the peak start anew, so that what imports held for a moment does not hide what the method holds."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def _leave_signals_to_parent() -> None:
    """Ignores what ends a group of processes: the parent ends this one, and takes it for no crash of the method."""
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def _end_with_parent(folder: Path) -> None:
    """Ends this process when its parent is gone, which closes the pipe, and removes what the parent cannot any more."""
    # Not sys.stdin, whose lock the interpreter wants at its end.
    os.read(0, 1)
    # Nobody is left to tell what could not be removed.
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
