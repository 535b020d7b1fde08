"""Pictures of meshes before and after denoising, whole and close up, to be looked at.

    python benches/gallery.py --out DIR [--level 0.2 | --as-is] MESH …

With ``--level`` the meshes are clean: noise is added, and panels coloured by angular error follow. With ``--as-is``
they are scans without a truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.mesh_io import load, to_arrays
from gcnd.metrics import normal_angles, normal_error
from gcnd.picture import Panel, save_panels
from gcnd.weights import load_cascade

CLOSE_UP = (0.5, 0.7, 0.25)


def main() -> None:
    """Writes two pictures a mesh."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("meshes", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--level", type=float, default=0.2)
    parser.add_argument("--as-is", action="store_true")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--azimuth", type=float, default=35.0)
    parser.add_argument("--elevation", type=float, default=25.0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    cascade = load_cascade(options.preset)
    for path in options.meshes:
        arrays, _ = to_arrays(load(path))
        mesh, _ = arrays.welded()
        truth, faces = mesh.vertices, mesh.faces
        noisy = truth if options.as_is else add_noise(truth, faces, level=options.level, seed=7)
        clean = denoise_arrays(noisy, faces, cascade)
        rows = panels(truth, noisy, clean, faces, options.as_is)
        for suffix, zoom in (("whole", None), ("close", CLOSE_UP)):
            picture = options.out / f"{path.stem}_{suffix}.png"
            view = {"azimuth": options.azimuth, "elevation": options.elevation}
            save_panels(picture, rows, zoom=zoom, **view)
            print(picture, flush=True)


def panels(
    truth: np.ndarray, noisy: np.ndarray, clean: np.ndarray, faces: np.ndarray, as_is: bool
) -> list[list[Panel]]:
    """Noisy and clean; with a truth also that, and both errors."""
    if as_is:
        moved = normal_angles(clean, noisy, faces)
        return [
            [
                Panel("before", noisy, faces),
                Panel("after", clean, faces),
                Panel("change", clean, faces, moved),
            ]
        ]
    shaded = [Panel("noisy", noisy, faces), Panel("clean", clean, faces), Panel("truth", truth, faces)]
    coloured = [
        Panel(f"E_a {normal_error(v, truth, faces):.2f}°", v, faces, normal_angles(v, truth, faces))
        for v in (noisy, clean)
    ]
    return [shaded, coloured]


if __name__ == "__main__":
    main()
