"""What people call; see `fuzz_cases`."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
import wild
from fuzz_checks import finite, refusals
from torch import nn
from wild import Rng

from gcnd import _geom
from gcnd.auto import CANDIDATES, choose_preset, read_signs
from gcnd.controls import Controls
from gcnd.denoiser import Denoiser
from gcnd.errors import GcndError, MeshError
from gcnd.mesh_info import mesh_info
from gcnd.mesh_io import to_arrays
from gcnd.nn.cascade import Cascade, CascadeConfig, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import NetworkConfig
from gcnd.runs import Moved, run_on
from gcnd.weights import save_cascade

NODES = NetworkConfig("nodes", 17, (8,), (8,), 16, (8,), 4, "node")
CENTRE = NetworkConfig("centre", 8, (8,), (8,), 16, (8,), 4, "edge")
CONFIG = CascadeConfig(
    (
        StageConfig(NODES, PatchConfig(n_nodes=16), passes=1, coverage=1.5),
        StageConfig(CENTRE, PatchConfig(n_nodes=16, vertex_offsets=False, budget="random")),
    ),
    RefinementConfig(2, 0.3, 1.5),
    vertex_iterations=3,
)


def tiny_cascade(config: CascadeConfig = CONFIG) -> Cascade:
    torch.manual_seed(0)
    cascade = Cascade(config).eval()
    for network in cascade.stages:
        nn.init.normal_(network.out.weight, std=0.3)  # type: ignore[union-attr, arg-type]
    return cascade


def tiny_weights(folder: Path) -> Path:
    path = folder / "tiny.safetensors"
    if not path.exists():
        save_cascade(path, tiny_cascade())
    return path


@cache
def tiny_denoiser(folder: Path) -> Denoiser:
    return Denoiser(str(tiny_weights(folder)), precision="float32")


def arrays(rng: Rng, _: Path) -> bool:
    given = wild.pair(rng)
    with refusals(MeshError):
        found, rebuild = to_arrays(given)
        vertices, faces = rebuild(found.vertices)
    finite(found.vertices)
    assert found.vertices.dtype == np.float64
    assert found.faces.dtype == np.uint32
    assert found.faces.max() < len(found.vertices)
    assert np.shape(vertices) == found.vertices.shape
    assert np.shape(faces) == found.faces.shape
    return True


def random_controls(rng: Rng, n_vertices: int) -> dict[str, Any]:
    options: dict[str, Any] = {}
    if rng.random() < 0.4:
        options["strength"] = wild.number(rng) if rng.random() < 0.2 else float(rng.random())
    for name in ("max_displacement", "max_displacement_edges"):
        if rng.random() < 0.3:
            options[name] = wild.number(rng) if rng.random() < 0.4 else float(rng.random())
    if rng.random() < 0.3:
        keep: Any = rng.random(n_vertices + (rng.random() < 0.1)) < 0.3
        options["keep"] = keep if rng.random() < 0.8 else keep.astype(rng.choice(["i4", "f8", "U3"]))
    if rng.random() < 0.3:
        options["preserve_volume"] = True
    return options


def denoise(rng: Rng, folder: Path) -> bool:
    given = wild.pair(rng) if rng.random() < 0.3 else wild.mesh(rng)
    n = len(given[0]) if hasattr(given[0], "__len__") else 0
    with refusals(GcndError):
        controls = Controls(**random_controls(rng, n) if rng.random() < 0.3 else {})
        done = tiny_denoiser(folder).run(given, controls=controls)
        report = json.dumps(done.report(), allow_nan=False)
    finite(done.mesh[0]) if np.asarray(done.mesh[0]).dtype != np.float16 else None
    assert np.asarray(done.mesh[0]).shape == done.before.vertices.shape
    assert np.array_equal(np.asarray(done.mesh[1]), np.asarray(given[1]))
    if done.confidence is not None:
        assert ((done.confidence >= 0) & (done.confidence <= 1)).all()
    assert len(report) > 100
    return True


def controls(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    options = random_controls(rng, len(vertices))

    def move(surface: Any, *_: Any) -> Moved:
        mesh = surface.mesh
        with np.errstate(over="ignore"):
            step = rng.normal(size=mesh.vertices.shape) * rng.choice([0.0, 1e-3, 1.0, 1e6])
            moved = mesh.vertices + step * max(np.abs(mesh.vertices).max(), 1e-300)
            return Moved(np.clip(moved, -1.7e308, 1.7e308))

    with refusals(GcndError):
        done = run_on((vertices, faces), move, Controls(**options), {"method": "fuzz"})
    finite(done.after)
    ways = np.linalg.norm(done.after - vertices, axis=1)
    if options.get("strength") == 0.0 and not options.get("preserve_volume"):
        assert np.array_equal(done.after, vertices)
    if "keep" in options:
        assert np.array_equal(done.after[options["keep"]], vertices[options["keep"]])
    if options.get("max_displacement") is not None:
        assert (ways <= options["max_displacement"]).all()
    return True


def info(rng: Rng, _: Path) -> bool:
    with refusals(GcndError):
        mesh, _rebuild = to_arrays(wild.mesh(rng))
        found = mesh_info(mesh.vertices, mesh.faces)
    finite([value for value in found.values() if isinstance(value, float)] or [0.0])
    return True


def signs(rng: Rng, _: Path) -> bool:
    with refusals(GcndError):
        mesh, _rebuild = to_arrays(wild.mesh(rng))
        welded, _ids = mesh.welded()
        topology = _geom.Topology(welded.faces, len(welded.vertices))
        found = read_signs(topology, welded.vertices, welded.faces)
    finite([*found.described().values()])
    assert choose_preset(found).preset in CANDIDATES
    return True
