"""Whole denoise on generated meshes: seconds by stage, faces/s and peak memory, as JSON with hardware and commit.

    python benches/end_to_end.py [--faces 20000 100000 1000000] [--preset default]

Every size runs in a process of its own, so that peak memory is that size's alone.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time

import numpy as np


def bumpy_sphere(n_faces: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed grid sphere of about ``n_faces`` faces with bumps, so that normals vary everywhere."""
    rows = round((n_faces / 4) ** 0.5)
    columns = 2 * rows
    theta = (np.arange(rows) + 0.5) / rows * np.pi
    phi = np.arange(columns) / columns * 2 * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    radius = 1 + 0.05 * np.sin(9 * t) * np.cos(7 * p)
    body = np.stack([radius * np.sin(t) * np.cos(p), radius * np.sin(t) * np.sin(p), radius * np.cos(t)], -1)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return body.reshape(-1, 3), faces.astype(np.uint32)


def measure(n_faces: int, preset: str) -> dict[str, object]:
    """Denoises one mesh in this process."""
    import torch

    from gcnd.data.noise import add_noise
    from gcnd.denoise import denoise_arrays
    from gcnd.metrics import normal_error
    from gcnd.weights import load_cascade

    truth, faces = bumpy_sphere(n_faces)
    noisy = add_noise(truth, faces, level=0.2, seed=0)
    started = time.perf_counter()
    cascade = load_cascade(preset)
    loaded = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    clean = denoise_arrays(noisy, faces, cascade)
    seconds = time.perf_counter() - loaded
    return {
        "faces": len(faces),
        "preset": preset,
        "seconds": round(seconds, 3),
        "seconds_loading_weights": round(loaded - started, 3),
        "faces_per_second": round(len(faces) / seconds),
        "peak_memory_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "memory_before_mib": round(before / 1024),
        "e_a_noisy": round(normal_error(noisy, truth, faces), 3),
        "e_a_clean": round(normal_error(clean, truth, faces), 3),
        "threads": torch.get_num_threads(),
    }


def hardware() -> dict[str, object]:
    """Processor, cores, versions and commit."""
    import torch

    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    processor = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
        processor = names[0] if names else processor
    return {
        "processor": processor,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "commit": commit,
    }


def main() -> None:
    """Measures every size and prints JSON."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--faces", type=int, nargs="+", default=[20_000, 100_000, 1_000_000])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.faces[0], options.preset)))
        return
    results = []
    for n_faces in options.faces:
        command = [sys.executable, __file__, "--one", "--faces", str(n_faces), "--preset", options.preset]
        results.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
        print(results[-1], file=sys.stderr, flush=True)
    print(json.dumps({"hardware": hardware(), "results": results}, indent=1))


if __name__ == "__main__":
    main()
