"""Vertices on a boundary held, moved along it, or free: what each does to open meshes.

    python benches/boundary.py [--preset fast] [--pictures DIR]

prints a table in Markdown. Lengths are in mean edges of the input. "Across" is the direction that lies in the clean
surface and points outwards across its rim. "Moved across" is how far the rim went that way, root mean square; "mean" is
its mean, below 0 where the outline shrinks; "off across" is the rim's distance from the true one that way.
With ``--pictures``, frames are drawn before and after, from the camera's place.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

import numpy as np
import trimesh

from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.data.shapes import make_shape
from gcnd.denoise import Boundary, denoise_arrays
from gcnd.picture import Panel, save_panels, view_matrix
from gcnd.scans import simulate
from gcnd.weights import load_cascade

AZIMUTH, ELEVATION = 35.0, 25.0
CLOSE_UP = (0.3, 0.7, 0.25)
SCANS = (("kinect1", 2_000_006, "cad"), ("kinect1", 2_000_007, "feature"), ("fusion", 2_000_003, "smooth"))
SMALL = {"kinect1": {"size": 0.3, "distance": 0.9}, "fusion": {"size": 0.3, "distance": 0.9}}

Case = tuple[str, np.ndarray, np.ndarray, np.ndarray]


def main() -> None:
    """Prints the table and draws the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    cascade = load_cascade(options.preset)
    print("| mesh | faces | boundary | E_a | E_a at the rim | E_v | moved across | mean | off across |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, clean, noisy, faces in (*shapes(), *scans()):
        results = {"input": noisy}
        for policy in get_args(Boundary):
            results[policy] = denoise_arrays(noisy, faces, cascade, boundary=policy)
        for policy, result in results.items():
            print(f"| {name} | {len(faces)} | {policy} | {row(clean, noisy, result, faces)} |", flush=True)
        if options.pictures is not None and name.startswith("kinect1"):
            options.pictures.mkdir(parents=True, exist_ok=True)
            panels = [Panel(policy, result, faces) for policy, result in results.items()]
            panels.append(Panel("truth", clean, faces))
            for suffix, zoom in (("whole", None), ("close", CLOSE_UP)):
                path = options.pictures / f"{name.replace(' ', '-')}-{suffix}.png"
                save_panels(path, [panels], azimuth=AZIMUTH, elevation=ELEVATION, zoom=zoom)


def shapes() -> list[Case]:
    """A flat sheet, a cap of a sphere and a box without lid, with noise of 0.2 mean edges along the normals."""
    meshes = []
    side = np.arange(51.0)
    points = np.stack([*np.meshgrid(side, side), np.zeros((51, 51))], axis=-1).reshape(-1, 3)
    corners = (np.arange(50)[:, None] * 51 + np.arange(50)).ravel()
    halves = ([0, 1, 52], [0, 52, 51])
    meshes.append(("sheet", points, np.concatenate([corners[:, None] + half for half in halves])))
    ball = trimesh.creation.icosphere(subdivisions=5)
    box = trimesh.creation.box()
    for _ in range(4):
        box = box.subdivide()
    box.merge_vertices()
    for name, mesh, is_kept in (
        ("cap", ball, ball.triangles_center[:, 2] > 0.3),
        ("open box", box, box.triangles_center[:, 2] < 0.499),
    ):
        part = mesh.submesh([np.flatnonzero(is_kept)], append=True)
        meshes.append((name, np.array(part.vertices), np.array(part.faces)))
    cases = []
    for name, vertices, faces in meshes:
        ids = faces.astype(np.uint32)
        cases.append((name, vertices, add_noise(vertices, ids, level=0.2, seed=1), ids))
    return cases


def scans() -> list[Case]:
    """Simulated scans of shapes never trained on."""
    towards = view_matrix(AZIMUTH, ELEVATION)[2]
    cases = []
    for kind, seed, shape_kind in SCANS:
        shape = make_shape(seed, shape_kind)
        view = {"view": towards} if kind == "kinect1" else {}
        pair = simulate(kind, shape.vertices, shape.faces, seed=1, **SMALL[kind], **view)
        cases.append((f"{kind} {shape_kind}", pair.clean_vertices, pair.noisy_vertices, pair.faces))
    return cases


def row(clean: np.ndarray, noisy: np.ndarray, result: np.ndarray, faces: np.ndarray) -> str:
    """The figures of one result."""
    edge = _geom.mean_edge_length(noisy, faces)
    rim, across = rim_directions(clean, faces)
    moved, off = (((result - other)[rim] * across).sum(axis=1) / edge for other in (noisy, clean))
    angles = _geom.normal_angles(*(_geom.face_geometry(v, faces)[0] for v in (result, clean)))
    at_rim = np.isin(faces, rim).any(axis=1)
    distance = 1000 * _geom.vertex_error(result, faces, clean, faces, 20_000, 0)
    figures = (
        f"{np.nanmean(angles):.2f}",
        f"{np.nanmean(angles[at_rim]):.2f}",
        f"{distance:.3f}",
        f"{np.sqrt((moved**2).mean()):.4f}",
        f"{moved.mean():+.4f}",
        f"{np.sqrt((off**2).mean()):.4f}",
    )
    return " | ".join(figures)


def rim_directions(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ids of the vertices on a boundary (R,), and the direction outwards across it at each (R, 3)."""
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, edge, counts = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True)
    start, end = ends[counts[edge.reshape(-1)] == 1].T
    tangents, normals = np.zeros((2, len(vertices), 3))
    for vertex in (start, end):
        np.add.at(tangents, vertex, vertices[end] - vertices[start])
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    for corner in range(3):
        np.add.at(normals, faces[:, corner], np.cross(b - a, c - a))
    rim = np.unique([start, end])
    across = np.cross(tangents, normals)[rim]
    return rim, across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)


if __name__ == "__main__":
    main()
