"""Small shapes and a small stage that the tests of `gcnd.train` share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.data import shape_cache
from gcnd.data.shapes import Shape
from gcnd.nn.cascade import PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import NetworkConfig
from gcnd.train import corpus as corpus_module
from gcnd.train import run as run_module
from gcnd.train.loop import TrainConfig
from gcnd.train.recipes import get_recipe
from gcnd.train.samples import ChunkConfig, CleanShape

NETWORK = NetworkConfig("nodes", 17, (8,), (8, 12), 16, (12, 8), 4, "node")

STAGE = StageConfig(NETWORK, PatchConfig(n_nodes=32), passes=1, coverage=1.5)

CHUNK = ChunkConfig(n_meshes=2, n_patches=16)

TRAIN = TrainConfig(STAGE, steps=6, batch=8, warmup=2, chunk=CHUNK, ema_decay=0.9, seed=3)
"""Two batches a chunk, so that step 3 starts in the middle of one."""


def sphere() -> Shape:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    return Shape("sphere", "smooth", np.array(mesh.vertices) / 2, mesh.faces.astype(np.uint32))


def cube(n: int = 6) -> Shape:
    """Faces cut into n × n squares, 12 n² triangles, one edge of the squares long in each."""
    mesh = trimesh.creation.box()
    vertices, faces = np.array(mesh.vertices), mesh.faces
    weights = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    index = {w: k for k, w in enumerate(weights)}
    pieces = []
    for i, j, k in weights:
        if k > 0:
            pieces.append([index[i + 1, j, k - 1], index[i, j + 1, k - 1], index[i, j, k]])
        if k > 1:
            pieces.append([index[i + 1, j, k - 1], index[i + 1, j + 1, k - 2], index[i, j + 1, k - 1]])
    # The box has corners at ±1/2, and n is a power of two or the weights are exact all the same: sums of whole
    # numbers over n, rounded once, so that neighbouring triangles agree to the bit.
    points = np.array(weights) @ vertices[faces] / n
    corners = (np.array(pieces)[None] + len(weights) * np.arange(len(faces))[:, None, None]).reshape(-1, 3)
    representatives, welded = _geom.weld(np.ascontiguousarray(points.reshape(-1, 3)))
    clean: NDArray[np.float64] = points.reshape(-1, 3)[representatives]
    return Shape("cube", "cad", clean, np.ascontiguousarray(welded[corners]))


def clean(shape: Shape) -> CleanShape:
    return CleanShape(shape.name, shape.kind, shape.vertices, shape.faces)


RECIPE = replace(
    get_recipe("default"),
    name="tiny",
    stages=(
        replace(TRAIN, steps=5),
        replace(TRAIN, stage=replace(STAGE, passes=2), steps=4, seed=4),
    ),
    n_shapes=2,
    pool_size=2,
    refinement=RefinementConfig(iterations=3, sigma_r=0.2, tolerance=1.1),
)


def use_small_shapes(patched: pytest.MonkeyPatch) -> None:
    """Two small shapes in place of the procedural ones, and a checkpoint after every step."""

    def load_shapes(
        n: int, seed: int, directory: Path, *, kinds: Mapping[str, float], **_: object
    ) -> list[Shape]:
        if "edged" in kinds:
            return [replace(cube(2), name=f"edged {seed + i}", kind="edged") for i in range(n)]
        return [sphere(), cube(4)][: 1 if seed == corpus_module.VALIDATION_SEED else n]

    patched.setattr(shape_cache, "load_shapes", load_shapes)
    patched.setattr(run_module, "CHECKPOINT_SECONDS", -1.0)


def logged(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]
