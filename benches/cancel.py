"""How long it takes to stop: from the wish to the end of the run, and from Ctrl-C to the end of the process.

    python benches/cancel.py [--faces 100000] [--preset default] [--times 12]

Prints the median and the longest of both, in seconds, at moments spread over a whole run, and what was left behind.
"""

from __future__ import annotations

import argparse
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from end_to_end import bumpy_sphere

from gcnd import Cancelled, Denoiser
from gcnd.data.noise import add_noise
from gcnd.mesh_io import save


def seconds_to_cancel(denoiser: Denoiser, mesh: tuple[np.ndarray, np.ndarray], delay: float) -> float | None:
    """Seconds from the wish to the exception; None where the run was over before."""
    wish: list[float] = []
    timer = threading.Timer(delay, lambda: wish.append(time.perf_counter()))
    before = threading.active_count()
    timer.start()
    try:
        denoiser.run(mesh, progress=lambda *_: not wish)
    except Cancelled:
        taken = time.perf_counter() - wish[0]
        timer.join()
        if threading.active_count() > before:
            raise SystemExit(f"threads are left: {threading.enumerate()}") from None
        return taken
    timer.join()
    return None


def seconds_to_exit(source: Path, preset: str, delay: float) -> float | None:
    """Seconds from Ctrl-C to the end of `gcnd denoise`; None where it was over before."""
    target = source.with_name("out.ply")
    command = [
        sys.executable,
        "-m",
        "gcnd",
        "denoise",
        str(source),
        str(target),
        "--preset",
        preset,
        "-q",
    ]
    process = subprocess.Popen(command)
    time.sleep(delay)
    started = time.perf_counter()
    process.send_signal(signal.SIGINT)
    code = process.wait()
    taken = time.perf_counter() - started
    left = [path.name for path in source.parent.iterdir() if path != source]
    target.unlink(missing_ok=True)
    if code == 0:
        return None
    if code not in (130, -signal.SIGINT) or left:
        print(f"after {delay:.2f} s: exit code {code}, left behind {left}")
    return taken


def show(what: str, found: list[float | None]) -> None:
    """Prints median and longest."""
    times = [value for value in found if value is not None]
    late = len(found) - len(times)
    print(
        f"{what}: median {statistics.median(times):.3f} s, longest {max(times):.3f} s, {len(times)} times, {late} late"
    )


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--faces", type=int, default=100_000)
    parser.add_argument("--preset", default="default")
    parser.add_argument("--times", type=int, default=12)
    options = parser.parse_args()
    truth, faces = bumpy_sphere(options.faces)
    noisy = add_noise(truth, faces, level=0.2, seed=0)
    denoiser = Denoiser(options.preset)
    started = time.perf_counter()
    denoiser.run((noisy, faces))
    whole = time.perf_counter() - started
    print(f"{len(faces)} faces, {options.preset}: {whole:.1f} s undisturbed")
    delays = [whole * (i + 0.5) / options.times for i in range(options.times)]
    show("cancel", [seconds_to_cancel(denoiser, (noisy, faces), delay) for delay in delays])
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "in.ply"
        save((noisy, faces), source)
        delays = [1.0 + (whole + 2.0) * i / options.times for i in range(options.times)]
        show("Ctrl-C", [seconds_to_exit(source, options.preset, delay) for delay in delays])


if __name__ == "__main__":
    main()
