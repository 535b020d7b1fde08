"""Simulated scans of generated shapes: how noisy they are, how long they take, and docs/images/scan-*.png.

    python benches/scans.py

prints a table in Markdown and draws clean mesh, scan and close-up side by side for every kind.
"""

from __future__ import annotations

import time
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from gcnd.data.shapes import Shape, make_shape
from gcnd.metrics import normal_error
from gcnd.picture import Panel, _window, render, view_matrix
from gcnd.scans import SCAN_KINDS, ScanKind, ScanPair, simulate

SHAPES = ((2_000_006, "cad"), (2_000_012, "cad"), (2_000_003, "smooth"), (2_000_007, "feature"))
"""Seeds far from those that training and validation draw from."""

SHOWN = {"kinect1": 0, "kinect2": 3, "fusion": 2, "print": 1}
"""Which of the shapes a picture shows."""

AZIMUTH, ELEVATION = 35.0, 25.0
CLOSE_UP = (0.5, 0.5, 0.22)
IMAGES = Path(__file__).parent.parent / "docs" / "images"
PIXELS = 420
COLOURS = 40


def main() -> None:
    """Prints the table and draws the pictures."""
    shapes = [make_shape(seed, kind) for seed, kind in SHAPES]  # type: ignore[arg-type]
    towards = view_matrix(AZIMUTH, ELEVATION)[2]
    print("| kind | shape | faces | E_a, degrees | processor seconds |\n|---|---|---|---|---|")
    for kind in SCAN_KINDS:
        for number, shape in enumerate(shapes):
            options = {"view": towards} if kind in ("kinect1", "kinect2") else {}
            started = time.process_time()
            pair = simulate(kind, shape.vertices, shape.faces, seed=1, **options)
            seconds = time.process_time() - started
            error = normal_error(pair.noisy_vertices, pair.clean_vertices, pair.faces)
            print(f"| {kind} | {shape.name} | {len(pair.faces)} | {error:.1f} | {seconds:.2f} |", flush=True)
            if SHOWN[kind] == number:
                draw(kind, shape, pair)


def draw(kind: ScanKind, shape: Shape, pair: ScanPair) -> None:
    """Draws clean mesh, scan and a close-up of the scan from the scanner's place."""
    view = view_matrix(AZIMUTH, ELEVATION)
    clean = Panel("", shape.vertices, shape.faces)
    scan = Panel("", pair.noisy_vertices, pair.faces)
    whole, near = _window(clean, view, None), _window(clean, view, CLOSE_UP)
    shots = [
        render(p, view, w, pixels=PIXELS, kind="png")
        for p, w in ((clean, whole), (scan, whole), (scan, near))
    ]
    strip = Image.new("RGB", (PIXELS * len(shots), PIXELS), "white")
    for place, shot in enumerate(shots):
        strip.paste(Image.open(BytesIO(shot)).convert("RGB"), (PIXELS * place, 0))
    used = np.flatnonzero(np.asarray(strip.convert("L")).min(axis=1) < 250)
    strip = strip.crop((0, int(used[0]), strip.width, int(used[-1]) + 1))
    strip.quantize(COLOURS).save(IMAGES / f"scan-{kind}.png", optimize=True)


if __name__ == "__main__":
    main()
