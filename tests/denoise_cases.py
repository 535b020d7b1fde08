"""Small networks with random weights and a noisy sphere, for tests of the whole line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import nn

from gcnd import _geom, denoise
from gcnd.data.noise import add_noise
from gcnd.nn.cascade import Cascade, CascadeConfig, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import NetworkConfig
from gcnd.weights import save_cascade

Arrays = tuple[NDArray[np.float64], NDArray[np.uint32]]

NODES = NetworkConfig("nodes", 17, (8,), (8, 12), 16, (12, 8), 4, "node")
CENTRE = NetworkConfig("centre", 8, (8,), (12,), 16, (12, 8), 4, "edge")

CONFIG = CascadeConfig(
    (
        StageConfig(NODES, PatchConfig(n_nodes=32), passes=2, coverage=1.5),
        StageConfig(CENTRE, PatchConfig(n_nodes=16, vertex_offsets=False, budget="random")),
    ),
    RefinementConfig(2, 0.3, 1.5),
    vertex_iterations=5,
)

EVERY_FACE = replace(CONFIG, stages=(replace(CONFIG.stages[0], coverage=None),))
"""No face is left to chance: one patch around each, node by node."""


def random_cascade(config: CascadeConfig = CONFIG) -> Cascade:
    torch.manual_seed(0)
    cascade = Cascade(config).eval()
    for network in cascade.stages:
        nn.init.normal_(network.out.weight, std=0.3)
    return cascade


def noisy_sphere(subdivisions: int = 2) -> Arrays:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    faces = mesh.faces.astype(np.uint32)
    return add_noise(np.array(mesh.vertices), faces, kind="isotropic", level=0.3, seed=2), faces


VERTICES, FACES = noisy_sphere()

EDGE = _geom.mean_edge_length(VERTICES, FACES)

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0.1], [1, 1, 0], [0, 1, 0.1]])


def write_random_weights(folder: Path) -> str:
    path = folder / "random.safetensors"
    save_cascade(path, random_cascade())
    return str(path)


def denoised_sphere(preset: str) -> NDArray[np.float64]:
    vertices, _ = denoise((VERTICES, FACES), preset=preset)
    assert np.isfinite(vertices).all()
    assert np.abs(vertices - VERTICES).max() > 0.1 * EDGE
    return vertices
