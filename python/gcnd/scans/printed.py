"""A model that was printed and scanned: layers, blur, and the noise of a good scanner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gcnd.data.noise import AnyFaces, FloatArray, mean_edge_length, smoothed, vertex_normals
from gcnd.scans.camera import random_direction
from gcnd.scans.frame import ScanPair


@dataclass(frozen=True)
class Print:
    """How a model is printed and scanned, in mean edge lengths; docs/scans.md says where the numbers come from.

    A print's layers and a scanner's noise have their sizes in micrometres, but vertices show nothing finer than a few
    edges, so that their sizes are told in edges.

    Attributes:
        blur_rounds: Rounds of averaging over the vertex graph: what the nozzle and the scanner cannot resolve.
        layer: Height of the steps, mean edges.
        relief: Deviation of the ridges that the layers leave, mean edges.
        warp: Deviation of the slow error of the printer, mean edges.
        warp_length: Its half wavelength, as a share of the bounding-box diagonal.
        noise: Deviation of the scanner's noise, mean edges.
        noise_rounds: Rounds of averaging that correlate the scanner's noise.
    """

    blur_rounds: int = 1
    layer: float = 4.0
    relief: float = 0.12
    warp: float = 0.3
    warp_length: float = 0.15
    noise: float = 0.06
    noise_rounds: int = 1


def printed_pair(vertices: FloatArray, faces: AnyFaces, setting: Print, rng: np.random.Generator) -> ScanPair:
    """Makes a pair of a printed and scanned model: the clean mesh's own vertices, moved.

    v' = blur(v) + ē (relief · r(v) + warp · w(v) + noise · ε_v) n_v, with ē the mean edge length, n_v the normal of the
    blurred mesh, ε correlated normal noise of variance 1 over the vertex graph, w a smooth field through space of
    variance 1, and r a wave of variance 1 along the direction of printing, of period ``layer`` and a phase that wanders
    slowly.

    Args:
        vertices: (V, 3) float64, any unit.
        faces: (F, 3), vertex ids.
        setting: How it is printed and scanned.
        rng: Draws everything.

    Returns:
        The pair, in the unit and with the faces and the vertices of the clean mesh.

    Example:
        >>> from gcnd.data.noise import mean_edge_length
        >>> clean = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> still = Print(blur_rounds=0, relief=0, warp=0, noise=0)
        >>> printed_pair(clean, np.array([[0, 1, 2]]), still, np.random.default_rng(0)).noisy_vertices.tolist()
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    clean = np.asarray(vertices, dtype=np.float64)
    ids = np.ascontiguousarray(faces, dtype=np.uint32)
    edge = mean_edge_length(clean, ids)
    diagonal = float(np.linalg.norm(np.ptp(clean, axis=0)))
    up = random_direction(rng)
    slow = _wave_through_space(clean, max(setting.warp_length * diagonal, edge), rng)
    drift = _wave_through_space(clean, max(0.5 * diagonal, edge), rng)
    phase = 2 * np.pi * (clean @ up) / max(setting.layer * edge, np.finfo(float).tiny) + drift
    noise = smoothed(rng.standard_normal(len(clean)), ids, setting.noise_rounds)
    deviation = float(np.sqrt(np.mean(np.square(noise))))
    amount = setting.relief * np.sqrt(2) * np.sin(phase) + setting.warp * slow
    if deviation > 0:
        amount = amount + setting.noise * noise / deviation
    blurred = np.stack([smoothed(clean[:, axis], ids, setting.blur_rounds) for axis in range(3)], axis=1)
    moved = blurred + edge * amount[:, None] * vertex_normals(blurred, ids)
    return ScanPair(np.asarray(moved, dtype=np.float64), clean, ids)


def _wave_through_space(points: FloatArray, half_length: float, rng: np.random.Generator) -> FloatArray:
    """(N,): a smooth random field of variance 1, the scaled sum of sixteen plane waves."""
    waves = rng.standard_normal((3, 16)) * np.pi / half_length / np.sqrt(3)
    phases = rng.uniform(0, 2 * np.pi, 16)
    return np.asarray(np.cos(points @ waves + phases).sum(axis=1) / np.sqrt(8))
