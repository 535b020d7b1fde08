"""Adds noise to a part, denoises it with the shipped weights, prints the errors and draws a picture.

Without arguments the part is generated; `python scripts/demo.py MESH` takes yours, which must be clean.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import gcnd
from gcnd.data.noise import add_noise
from gcnd.data.shapes import make_shape
from gcnd.mesh_io import load, save, to_arrays
from gcnd.metrics import normal_angles, normal_error, vertex_error
from gcnd.picture import Panel, save_panels

OUT = Path("demo")
LEVEL = 0.3
SHAPE_SEED = 2_000_006
"""Far from the seeds that training and validation draw from."""


class StageClock:
    """Adds up the seconds between progress reports by what was being done."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._label, self._since = "loading weights", time.perf_counter()

    def __call__(self, _fraction: float, label: str) -> None:
        """Takes a progress report."""
        now = time.perf_counter()
        self.seconds[self._label] = self.seconds.get(self._label, 0.0) + now - self._since
        self._label, self._since = label, now


def main(arguments: list[str]) -> None:
    """Runs the demo on a generated part or on the mesh that the first argument names."""
    OUT.mkdir(exist_ok=True)
    if arguments:
        arrays, _ = to_arrays(load(arguments[0]))
        name, truth, faces = Path(arguments[0]).stem, arrays.vertices, arrays.faces
    else:
        shape = make_shape(SHAPE_SEED, "cad")
        name, truth, faces = shape.name, shape.vertices, shape.faces
    noisy = add_noise(truth, faces, level=LEVEL, seed=1)
    clock = StageClock()
    started = time.perf_counter()
    clean, _ = gcnd.denoise((noisy, faces), progress=clock)
    total = time.perf_counter() - started
    report(name, truth, noisy, clean, faces, clock, total)
    draw(truth, noisy, clean, faces)


def report(
    name: str,
    truth: np.ndarray,
    noisy: np.ndarray,
    clean: np.ndarray,
    faces: np.ndarray,
    clock: StageClock,
    total: float,
) -> None:
    """Prints the errors before and after and the seconds of each stage; writes the meshes."""
    console = Console()
    console.print(
        f"{name}: {len(faces)} faces, noise {LEVEL} of the mean edge length along the normals", soft_wrap=True
    )
    table = Table("", "noisy", "clean")
    before, after = (normal_error(v, truth, faces) for v in (noisy, clean))
    table.add_row("E_a, degrees", f"{before:.2f}", f"{after:.2f}")
    before, after = (vertex_error(v, faces, truth, faces) * 1000 for v in (noisy, clean))
    table.add_row("E_v × 1000", f"{before:.3f}", f"{after:.3f}")
    console.print(table)
    for label, seconds in clock.seconds.items():
        console.print(f"  {seconds:6.2f} s  {label}")
    console.print(f"  {total:6.2f} s  in all")
    import trimesh

    for suffix, vertices in (("truth", truth), ("noisy", noisy), ("clean", clean)):
        path = OUT / f"{suffix}.ply"
        save(trimesh.Trimesh(vertices, faces, process=False), path)
        console.print(f"wrote {path}")


def draw(truth: np.ndarray, noisy: np.ndarray, clean: np.ndarray, faces: np.ndarray) -> None:
    """Draws noisy, clean and truth, shaded and coloured by angular error."""
    shaded = [Panel(t, v, faces) for t, v in (("noisy", noisy), ("clean", clean), ("truth", truth))]
    errors = [
        Panel(f"error {t}", v, faces, normal_angles(v, truth, faces))
        for t, v in (("noisy", noisy), ("clean", clean))
    ]
    path = OUT / "before_after.png"
    save_panels(path, [shaded, errors])
    Console().print(f"wrote {path}")


if __name__ == "__main__":
    main(sys.argv[1:])
