"""Draws the pictures of the guides and of docs/how-it-works.md into docs/images.

python scripts/draw_docs.py                  # all
python scripts/draw_docs.py passes patches   # some
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gcnd
from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.data.shapes import Shape, make_shape
from gcnd.filters import apply_filter
from gcnd.metrics import normal_angles
from gcnd.passes import run_passes
from gcnd.picture import Panel, save_panels, view_matrix
from gcnd.predict import PatchArrays, make_extractor, refined
from gcnd.scans import simulate
from gcnd.weights import load_cascade

OUT = Path(__file__).parent.parent / "docs" / "images"
N_PATCHES = 16
AZIMUTH, ELEVATION = 35.0, 50.0


def part() -> tuple[Shape, NDArray[np.float64]]:
    """The part of the guide and its noisy vertices."""
    shape = make_shape(2_000_006, "cad")
    return shape, add_noise(shape.vertices, shape.faces, level=0.3, seed=1)


def detailed() -> Shape:
    """The statue of the guide."""
    return make_shape(2_000_007, "feature")


def passes() -> None:
    """The mesh before the first pass and after each, coloured by error."""
    shape, noisy = part()
    truth, faces, vertices = shape.vertices, shape.faces, noisy
    cascade = load_cascade("default")
    topology = _geom.Topology(faces, len(vertices))
    errors = normal_angles(vertices, truth, faces)
    panels = [Panel(f"noisy: {errors.mean():.1f}°", vertices, faces, errors)]
    *early, last = run_passes(topology, noisy, cascade)
    after = [one.vertices for one in (*early[1:], last)]
    normals = refined(topology, last.vertices, last.prediction, cascade.config.refinement)
    after.append(_geom.update_vertices(topology, last.vertices, normals, cascade.config.vertex_iterations))
    for number, vertices in enumerate(after, start=1):
        errors = normal_angles(vertices, truth, faces)
        panels.append(Panel(f"after pass {number}: {errors.mean():.1f}°", vertices, faces, errors))
    save_panels(OUT / "passes.png", [panels], max_value=20.0)


def patches() -> None:
    """Patches on the noisy part: the nearer a face is to its patch's centre, the brighter."""
    shape, vertices = part()
    patch = load_cascade("default").passes()[0][0].patch
    topology = _geom.Topology(shape.faces, len(vertices))
    normals, _, _ = _geom.face_geometry(vertices, shape.faces)
    in_view = np.flatnonzero(normals @ view_matrix(AZIMUTH, ELEVATION)[2] > 0.4)
    centers = np.random.default_rng(0).choice(in_view, N_PATCHES, replace=False).astype(np.uint32)
    arrays = PatchArrays(N_PATCHES, patch)
    arrays.fill(make_extractor(topology, vertices, patch, 0), centers)
    nodes = np.zeros(len(shape.faces))
    for ids, mask in zip(arrays.face_ids, arrays.mask, strict=True):
        nodes[ids[mask > 0]] = patch.n_nodes - np.arange(patch.n_nodes)[mask > 0]
    save_panels(
        OUT / "patches.png",
        [[Panel(f"{N_PATCHES} patches of {patch.n_nodes} faces", vertices, shape.faces, nodes)]],
        azimuth=AZIMUTH,
        elevation=ELEVATION,
        max_value=float(patch.n_nodes),
        label="64: centre, 1: last node, 0: in none of them",
    )


def statue() -> None:
    """The statue: noisy, clean and truth."""
    shape = detailed()
    noisy = add_noise(shape.vertices, shape.faces, level=0.2, seed=1)
    clean, _ = gcnd.denoise((noisy, shape.faces))
    named = (("noisy", noisy), ("clean", clean), ("truth", shape.vertices))
    save_panels(OUT / "statue.png", [[Panel(name, vertices, shape.faces) for name, vertices in named]])


def camera() -> None:
    """A simulated frame, denoised by the network for scans and by a filter, from where the camera was."""
    shape = detailed()
    pair = simulate("kinect1", shape.vertices, shape.faces, seed=1)
    mesh = (pair.noisy_vertices, pair.faces)
    clean, _ = gcnd.denoise(mesh, preset="scan")
    guided, _ = apply_filter(mesh, "guided-normal", sigma_r=0.45, normal_iterations=40)
    normals, _, areas = _geom.face_geometry(pair.clean_vertices, pair.faces)
    x, y, z = areas @ normals
    save_panels(
        OUT / "camera.png",
        [
            [
                Panel("frame", *mesh),
                Panel("gcnd, weights for scans", clean, pair.faces),
                Panel("guided-normal", guided, pair.faces),
                Panel("truth", pair.clean_vertices, pair.faces),
            ]
        ],
        azimuth=float(np.degrees(np.arctan2(y, x))),
        elevation=float(np.degrees(np.arctan2(z, np.hypot(x, y)))),
    )


PICTURES = {"passes": passes, "patches": patches, "statue": statue, "camera": camera}


if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()
