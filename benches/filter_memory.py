"""Peak memory of each filter at its defaults on noisy tori, by number of faces: what a mesh of that size adds.

    python benches/filter_memory.py [--faces 20000 100000] [--methods l0 tgv]

Every run is a process of its own, forked from one that has loaded everything and run nothing. The slope between the
two sizes is what a million faces take, in MiB, the mesh itself, its adjacency and all copies in Python included. It
reads ``/proc``, so it needs Linux.
"""

from __future__ import annotations

import argparse
import os
import sys

import numpy as np
import trimesh  # noqa: F401  loaded before the forks, which would each count it otherwise

from gcnd.filters import apply_filter, list_filters

Arrays = tuple[np.ndarray, np.ndarray]


def noisy_torus(n_faces: int) -> Arrays:
    """A torus of about ``n_faces`` faces with noise of about a fifth of an edge in every coordinate."""
    rows = round((n_faces / 4) ** 0.5)
    columns = 2 * rows
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    across, around = 2 * np.pi * i / rows, 2 * np.pi * j / columns
    radius = 1.0 + 0.4 * np.cos(across)
    vertices = np.stack([radius * np.cos(around), radius * np.sin(around), 0.4 * np.sin(across)], -1)
    vertices += np.random.default_rng(1).normal(scale=0.2 * 2 * np.pi / columns, size=vertices.shape)
    right, below = (j + 1) % columns, (i + 1) % rows
    a, b, c, d = (rows_ * columns + at for rows_, at in ((i, j), (i, right), (below, j), (below, right)))
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces.astype(np.uint32)


def peak_mib(method: str, n_faces: int) -> tuple[int, float]:
    """Faces of the mesh and the peak memory, in MiB, of a process that filters it."""
    source, sink = os.pipe()
    child = os.fork()
    if child == 0:
        mesh = noisy_torus(n_faces)
        apply_filter(mesh, method)
        with open("/proc/self/status", encoding="ascii") as file:
            status = dict(line.split(":", 1) for line in file)
        os.write(sink, f"{len(mesh[1])} {status['VmHWM'].split()[0]}".encode())
        os._exit(0)
    os.close(sink)
    with os.fdopen(source) as file:
        told = file.read().split()
    os.waitpid(child, 0)
    if not told:
        sys.exit(f"error: {method} failed at {n_faces} faces")
    return int(told[0]), int(told[1]) / 1024


def mib_per_million(method: str, sizes: tuple[int, int]) -> float:
    """What a million faces add, in MiB, between two sizes of mesh."""
    (few, low), (many, high) = (peak_mib(method, n_faces) for n_faces in sizes)
    return (high - low) / (many - few) * 1e6


def main() -> None:
    """Prints a line for each filter."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [info.name for info in list_filters()]
    parser.add_argument("--faces", type=int, nargs=2, default=(20_000, 100_000), metavar="N")
    parser.add_argument("--methods", nargs="+", choices=names, default=names, metavar="NAME")
    options = parser.parse_args()
    print("| filter | MiB per million faces |\n|---|---|")
    for method in options.methods:
        print(f"| `{method}` | {mib_per_million(method, tuple(options.faces)):,.0f} |", flush=True)


if __name__ == "__main__":
    main()
