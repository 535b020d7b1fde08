"""Seconds of the filters that have a time to keep, on tori with noise, at their defaults.

python benches/filter_times.py
"""

from __future__ import annotations

import time

import numpy as np
import trimesh

from gcnd.data.noise import add_noise
from gcnd.filters import apply_filter

CASES = (("bilateral-normal", 1_000_000), ("guided-normal", 100_000), ("l0", 20_000))


def main() -> None:
    """Prints a line for each filter."""
    print("| filter | faces | seconds |\n|---|---|---|")
    for method, n_faces in CASES:
        around = int(n_faces**0.5)
        torus = trimesh.creation.torus(1.0, 0.4, major_sections=around, minor_sections=around // 2)
        faces = torus.faces.astype(np.uint32)
        noisy = add_noise(np.array(torus.vertices), faces, level=0.2, seed=1)
        started = time.perf_counter()
        apply_filter((noisy, faces), method)
        print(f"| {method} | {len(faces):,} | {time.perf_counter() - started:.2f} |", flush=True)


if __name__ == "__main__":
    main()
