"""What preset auto takes for prints, noise of each vertex's own and clean meshes, and what the choice costs.

    python benches/auto_choice.py --shapes 24 --prints 60
    python benches/auto_choice.py --meshes FOLDER          # clean meshes of yours in the place of generated ones
    python benches/auto_choice.py --prints 60 --accuracy 8 # also E_a of both presets on 8 of the prints

prints a table in Markdown. Generated shapes have seeds that no weights were trained on and no bound of auto was set on.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import gcnd
from gcnd import _geom
from gcnd.auto import choose_preset, read_signs
from gcnd.data.folders import find_meshes
from gcnd.data.noise import NoiseKind, add_noise
from gcnd.mesh_io import load, to_arrays
from gcnd.metrics import normal_error
from gcnd.scans import simulate
from gcnd.scans.training import draw_scan
from gcnd.train.corpus import VALIDATION_SEED, generated_shapes
from gcnd.train.samples import CleanShape

NOISES: tuple[tuple[NoiseKind, tuple[float, ...]], ...] = (
    ("gaussian", (0.02, 0.05, 0.1, 0.2, 0.4, 0.7)),
    ("impulsive", (0.3,)),
    ("isotropic", (0.05, 0.2)),
    ("varying", (0.2,)),
    ("correlated", (0.1, 0.3)),
)
FEWEST_FACES, MOST_FACES = 2_000, 120_000


class Case(NamedTuple):
    kind: str
    name: str
    noisy: NDArray[np.float64]
    clean: NDArray[np.float64]
    faces: NDArray[np.uint32]


def main() -> None:
    """Prints one row for each kind of mesh."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shapes", type=int, default=24, help="generated shapes")
    parser.add_argument("--shape-folder", type=Path, default=Path("runs/shapes"), help="where they are kept")
    parser.add_argument("--meshes", type=Path, help="clean meshes to take instead")
    parser.add_argument("--prints", type=int, default=60, help="prints, drawn as training draws them")
    parser.add_argument(
        "--accuracy", type=int, default=0, help="denoise this many of the prints with both presets"
    )
    parser.add_argument("--seed", type=int, default=77)
    arguments = parser.parse_args()
    shapes = meshes_of(arguments.meshes) or generated_shapes(
        arguments.shapes, VALIDATION_SEED, arguments.shape_folder
    )
    prints = list(print_cases(shapes, arguments.prints, arguments.seed))
    table(prints)
    table(noise_cases(shapes, arguments.seed))
    if arguments.accuracy:
        accuracy(prints, arguments.accuracy)


def meshes_of(folder: Path | None) -> list[CleanShape]:
    """Clean meshes of a folder, none too small or too large."""
    shapes = []
    for path in find_meshes(folder) if folder else []:
        mesh = to_arrays(load(path))[0].welded()[0]
        if FEWEST_FACES <= len(mesh.faces) <= MOST_FACES:
            shapes.append(CleanShape(path.stem, "feature", mesh.vertices, mesh.faces))
    return shapes


def print_cases(shapes: list[CleanShape], n: int, seed: int) -> Iterator[Case]:
    """Every shape as the simulator's defaults print it, and ``n`` prints of any setting."""
    for number, shape in enumerate(shapes):
        pair = simulate("print", shape.vertices, shape.faces, seed=seed + number)
        yield Case("print, defaults", shape.name, pair.noisy_vertices, pair.clean_vertices, pair.faces)
    for number in range(n):
        rng = np.random.default_rng([seed, number])
        shape, setting = shapes[number % len(shapes)], draw_scan("print", rng).setting
        pair = simulate("print", shape.vertices, shape.faces, seed=seed + number, setting=setting)
        yield Case("print, drawn", shape.name, pair.noisy_vertices, pair.clean_vertices, pair.faces)


def noise_cases(shapes: list[CleanShape], seed: int) -> Iterator[Case]:
    """Every shape clean, and with each noise of `NOISES`."""
    for shape in shapes:
        yield Case("clean", shape.name, shape.vertices, shape.vertices, shape.faces)
    for kind, levels in NOISES:
        for level in levels:
            for number, shape in enumerate(shapes):
                noisy = add_noise(shape.vertices, shape.faces, kind=kind, level=level, seed=seed + number)
                yield Case(f"{kind} {level}", shape.name, noisy, shape.vertices, shape.faces)


def choice_of(case: Case) -> str:
    """The preset that auto takes."""
    signs = read_signs(_geom.Topology(case.faces, len(case.noisy)), case.noisy, case.faces)
    return choose_preset(signs).preset


def table(cases: Iterator[Case] | list[Case]) -> None:
    """Prints how many of each kind get `scan`, and the names of those that are no prints."""
    counts: dict[str, list[int]] = {}
    named: dict[str, list[str]] = {}
    for case in cases:
        is_scan = choice_of(case) == "scan"
        count = counts.setdefault(case.kind, [0, 0])
        count[0] += 1
        count[1] += is_scan
        if is_scan and not case.kind.startswith("print"):
            named.setdefault(case.kind, []).append(case.name)
    print("| kind | meshes | scan | default | which got scan |\n|---|---|---|---|---|")
    for kind, (n, n_scan) in counts.items():
        print(f"| {kind} | {n} | {n_scan} | {n - n_scan} | {', '.join(named.get(kind, []))} |", flush=True)


def accuracy(prints: list[Case], n: int) -> None:
    """Prints E_a of both presets on prints of moderate size, evenly taken."""
    small = [case for case in prints if case.kind == "print, drawn" and len(case.faces) <= 20_000]
    print("\n| print | noisy | default | scan | auto takes |\n|---|---|---|---|---|")
    for case in small[:: max(1, len(small) // n)][:n]:
        errors = [normal_error(case.noisy, case.clean, case.faces)]
        for preset in ("default", "scan"):
            errors.append(
                normal_error(gcnd.denoise((case.noisy, case.faces), preset=preset)[0], case.clean, case.faces)
            )
        figures = " | ".join(f"{error:.2f}" for error in errors)
        print(f"| {case.name} | {figures} | {choice_of(case)} |", flush=True)


if __name__ == "__main__":
    main()
