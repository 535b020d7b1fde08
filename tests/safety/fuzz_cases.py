"""One function an entry: draws one case, runs it, and asserts what must hold of every answer.

Each returns whether the input was accepted; what is refused must be refused by the package's own errors. Anything else
that is raised, a panic of the compiled core included, is a failure of the case.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
import wild
from PIL import Image
from torch import nn
from wild import Rng

import gcnd
from gcnd import _geom, metrics
from gcnd.compare.rows import Row, RowFile
from gcnd.controls import Controls
from gcnd.denoiser import Denoiser
from gcnd.errors import ConfigError, GcndError, MeshError, WeightsError
from gcnd.filters import apply_filter, list_filters
from gcnd.mesh_info import mesh_info
from gcnd.mesh_io import load, save, to_arrays
from gcnd.nn.cascade import Cascade, CascadeConfig, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import NetworkConfig
from gcnd.runs import run_on
from gcnd.train.report import read_log
from gcnd.weights import load_cascade, registry, save_cascade

Case = Callable[[Rng, Path], bool]

CORE_REFUSALS = (GcndError, TypeError, OverflowError)
"""The binding is not public: Python's own errors for arguments of another type, or below zero, are clear enough."""


class Refused(Exception):
    """An input that was refused as it should be."""


@contextmanager
def refusals(*allowed: type[Exception]) -> Iterator[None]:
    """Turns allowed errors into `Refused`; checks that they say something, and not that memory ran out."""
    try:
        yield
    except allowed as error:
        message = str(error).strip()
        if not message or "MemoryError" in message or "Unable to allocate" in message:
            raise AssertionError(f"{type(error).__name__} is no refusal: {message!r}") from error
        raise Refused from error


def finite(values: Any) -> None:
    assert np.isfinite(np.asarray(values, dtype=np.float64)).all(), "NaN or infinity came out"


def unit_or_zero(normals: Any) -> None:
    lengths = np.linalg.norm(normals, axis=1)
    assert ((np.abs(lengths - 1.0) < 1e-9) | (lengths == 0.0)).all(), f"normals of lengths {lengths}"


# --- the compiled core ---------------------------------------------------------------------------------


def topology_of(vertices: Any, faces: Any) -> _geom.Topology:
    return _geom.Topology(faces, len(vertices))


def topology(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    n = int(rng.choice([len(vertices), 0, -1, 3])) if rng.random() < 0.2 else len(vertices)
    with refusals(*CORE_REFUSALS):
        found = _geom.Topology(faces, n)
    for (offsets, ids), rows, limit in (
        (found.edge_neighbors(), len(faces), len(faces)),
        (found.vertex_faces(), n, len(faces)),
    ):
        assert len(offsets) == rows + 1
        assert (np.diff(offsets.astype(np.int64)) >= 0).all()
        assert offsets[-1] == len(ids)
        assert (ids < limit).all()
    return True


def face_geometry(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    with refusals(*CORE_REFUSALS):
        _geom.validate(vertices, faces)
        normals, centroids, areas = _geom.face_geometry(vertices, faces)
        edge = _geom.mean_edge_length(vertices, faces)
    unit_or_zero(normals)
    assert not np.isnan(centroids).any()
    assert not np.isnan(areas).any()
    assert not np.isnan(edge)
    if np.abs(vertices).max() < 1e100:
        finite((edge, *areas))
        finite(centroids)
    return True


def weld(rng: Rng, _: Path) -> bool:
    vertices, _faces = wild.mesh(rng)
    with refusals(*CORE_REFUSALS):
        first, ids = _geom.weld(vertices)
    assert len(ids) == len(vertices)
    assert np.array_equal(vertices[first][ids], vertices, equal_nan=True)
    return True


def classes(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    scale = wild.number(rng) if rng.random() < 0.2 else 4.0
    sigma = wild.number(rng) if rng.random() < 0.2 else 1 / 3
    with refusals(*CORE_REFUSALS):
        found = _geom.classify_faces(
            topology_of(vertices, faces), vertices, patch_scale=scale, sigma_vote=sigma
        )
        roughness = _geom.mesh_roughness(topology_of(vertices, faces), vertices)
    assert (found <= 3).all()
    assert not np.isnan(roughness).any()
    return True


def patches(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    n = int(rng.choice([16, 32, 64, 0, 15, 513])) if rng.random() < 0.3 else 16
    options: dict[str, Any] = {
        "n_nodes": n,
        "budget": str(rng.choice(["nearest", "random"])),
        "voting_region": str(rng.choice(["patch", "two_ring", "nobody"])),
        "vertex_offsets": bool(rng.random() < 0.5),
        "scale_space": bool(rng.random() < 0.3),
        "seed": wild.below(rng, 5),
    }
    if rng.random() < 0.15:
        options["patch_scale"] = wild.number(rng)
    if rng.random() < 0.15:
        options["sigma_vote"] = wild.number(rng)
    if rng.random() < 0.3:
        options["roughness"] = np.array([wild.number(rng) for _ in range(rng.choice([4, 4, 3]))])
    p = 1 + wild.below(rng, 6)
    centers = rng.integers(0, max(len(faces), 1) + (rng.random() < 0.1), size=p).astype(np.uint32)
    with refusals(*CORE_REFUSALS):
        extractor = _geom.PatchExtractor(topology_of(vertices, faces), vertices, **options)
        shapes = [(p, n, extractor.n_channels), (p, n, 3), (p, n), (p, n), (p, 3, 3), (p,)]
        types = [np.float32, np.int32, np.uint32, np.uint8, np.float64, np.float64]
        if rng.random() < 0.1:
            which = wild.below(rng, 6)
            shapes[which] = (shapes[which][0] + int(rng.choice([-1, 1])), *shapes[which][1:])
        buffers = [np.full(shape, 77, dtype) for shape, dtype in zip(shapes, types, strict=True)]
        extractor.extract(centers, *buffers)  # type: ignore[arg-type]
    features, neighbors, face_ids, mask, frames, radii = buffers
    unit_or_zero(extractor.normals())
    assert ((neighbors >= 0) & (neighbors < n)).all()
    assert (face_ids < len(faces)).all()
    assert (mask <= 1).all()
    finite(features)
    finite(frames)
    assert np.abs(np.linalg.det(frames) - 1.0).max() < 1e-6
    assert not np.isnan(radii).any()
    return True


def averages(rng: Rng, _: Path) -> bool:
    n_faces, p, n, c = wild.below(rng, 20), 1 + wild.below(rng, 4), 1 + wild.below(rng, 8), 8
    wanted = {"nodes": (p, n), "centers": (p,)}[kind := str(rng.choice(["nodes", "centers"]))]
    ids = rng.integers(0, max(n_faces, 1) + (rng.random() < 0.1), size=wanted).astype(np.uint32)
    predicted = rng.normal(size=(*wanted, 3)).astype(np.float32)
    frames = np.linalg.qr(rng.normal(size=(p, 3, 3)))[0]
    features = rng.normal(size=(p, n, c)).astype(np.float32)
    mask = (rng.random((p, n)) < 0.8).astype(np.uint8)
    if rng.random() < 0.2:
        predicted.flat[wild.below(rng, predicted.size)] = np.float32(np.clip(wild.number(rng), -3e38, 3e38))
    if rng.random() < 0.15:
        features, frames = features[:, :-1], frames[: p - 1]
    fallback = wild.normals(rng, n_faces)
    with refusals(*CORE_REFUSALS):
        found = _geom.NormalAccumulator(n_faces)
        if kind == "nodes":
            found.add_nodes(
                np.ascontiguousarray(features), ids, mask, np.ascontiguousarray(frames), predicted
            )
        else:
            found.add_centers(ids, np.ascontiguousarray(frames), predicted)
        least = wild.number(rng) if rng.random() < 0.3 else 1.0
        cover = _geom.Cover(n_faces if rng.random() < 0.9 else n_faces + 1, least, wild.below(rng, 9))
        centers = [cover.next_centers(found, 1 + wild.below(rng, 5)) for _ in range(n_faces + 2)]
        normals = found.normals(fallback)
    come = np.concatenate(centers)
    assert len(np.unique(come)) == len(come) <= n_faces
    assert 0.0 <= cover.progress <= 1.0
    if np.isfinite(predicted).all():
        finite(found.spread())
        if np.isfinite(fallback).all():
            finite(normals)
    return True


def refinement(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    normals = wild.normals(rng, len(faces))
    options: dict[str, Any] = {"iterations": wild.below(rng, 4)}
    if rng.random() < 0.3:
        options["sigma_r"] = wild.number(rng)
    with refusals(*CORE_REFUSALS):
        adjacency = topology_of(vertices, faces)
        if rng.random() < 0.5:
            if rng.random() < 0.3:
                options["sigma_s"] = wild.number(rng)
            options["neighborhood"] = str(rng.choice(["shared_vertex", "shared_edge", "radius"]))
            if rng.random() < 0.2:
                options["radius"] = wild.number(rng)
            found = _geom.refine_normals(adjacency, vertices, normals, **options)
        else:
            spread = np.abs(rng.normal(size=len(faces) + (rng.random() < 0.05)))
            if len(spread) and rng.random() < 0.2:
                spread[0] = wild.number(rng)
            tolerance = wild.number(rng) if rng.random() < 0.3 else 1.0
            found = _geom.refine_consistent(
                adjacency,
                vertices,
                normals,
                spread,
                tolerance=tolerance,
                region_rounds=wild.below(rng, 4),
                **options,
            )
    assert found.shape == normals.shape
    if np.isfinite(normals).all():
        finite(found)
    return True


def vertex_update(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    normals = wild.normals(rng, len(faces))
    with refusals(*CORE_REFUSALS):
        found = _geom.update_vertices(topology_of(vertices, faces), vertices, normals, wild.below(rng, 5))
    assert found.shape == vertices.shape
    if np.isfinite(vertices).all() and np.isfinite(normals).all() and np.abs(vertices).max() < 1e100:
        finite(found)
    return True


def measures(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    other, others = (vertices + 0.1, faces) if rng.random() < 0.5 else wild.mesh(rng)
    if rng.random() < 0.3:
        result, truth = wild.normals(rng, len(faces)), wild.normals(rng, len(faces))
        with refusals(*CORE_REFUSALS):
            angles = _geom.normal_angles(result, truth)
        known = angles[~np.isnan(angles)]
        assert ((known >= 0) & (known <= 180)).all()
        return True
    with refusals(GcndError):
        error = metrics.vertex_error(vertices, faces, other, others, samples=1 + wild.below(rng, 200), seed=1)
        angles = metrics.normal_angles(vertices, other, faces)
    finite(error)
    known = angles[~np.isnan(angles)]
    assert ((known >= 0) & (known <= 180)).all()
    return True


def remeshing(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    with np.errstate(over="ignore", invalid="ignore"):
        size = float(np.ptp(vertices)) / (1 + wild.below(rng, 12)) if len(vertices) else 1.0
    target = wild.number(rng) if rng.random() < 0.2 else size
    extent = float(np.nan_to_num(np.ptp(vertices))) if len(vertices) else 0.0
    # A fine enough edge length asks for as many faces as there is memory: that is what was asked for.
    if 0.0 < target < 0.02 * extent:
        target = 0.02 * extent
    options: dict[str, Any] = {"iterations": wild.below(rng, 3)}
    if rng.random() < 0.2:
        options["feature_angle_deg"] = wild.number(rng)
    with refusals(*CORE_REFUSALS):
        points, corners = _geom.remesh(vertices, faces, target, **options)
    finite(points)
    assert corners.size == 0 or corners.max() < len(points)
    return True


def core_filter(name: str, rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    info = next(info for info in list_filters() if info.name == name)
    options: dict[str, Any] = {}
    for key, default in info.parameters.items():
        if isinstance(default, int) and not isinstance(default, bool):
            options[key] = wild.below(rng, 4)
        elif not isinstance(default, bool) and rng.random() < 0.2:
            options[key] = wild.number(rng)
    with refusals(GcndError):
        found, _same = apply_filter((vertices, faces), name, **options)
    assert found.shape == vertices.shape
    finite(found)
    return True


KERNELS = ("gather_max", "gather_max_argmax", "gather_max_backward", "gather_sum", "gather_sum_backward",
           "edge_max_leaky", "pool_nodes", "pool_nodes_backward", "knn")  # fmt: skip


def kernel(name: str, rng: Rng, _: Path) -> bool:
    """Sizes that fit or not, any index; the memory around every output must stay as it is."""
    p, n, c, k = (wild.below(rng, high) for high in (5, 12, 9, 5))
    dtype = rng.choice([np.float32, np.int16])

    def values(*shape: int) -> Any:
        drawn = rng.normal(size=shape) * rng.choice([1.0, 1.0, 1e30])
        if drawn.size and rng.random() < 0.2:
            drawn.flat[wild.below(rng, drawn.size)] = wild.number(rng)
        with np.errstate(over="ignore"):
            return (
                (drawn.astype(np.float32).view(np.uint32) >> 16).astype(np.uint16).view(np.int16)
                if (dtype == np.int16)
                else drawn.astype(np.float32)
            )

    whole: list[Any] = []

    def output(kind: Any, *shape: int) -> Any:
        if rng.random() < 0.08 and shape:
            shape = (*shape[:-1], max(0, shape[-1] + int(rng.choice([-1, 1]))))
        size = int(np.prod(shape))
        whole.append(np.full(size + 64, 99, dtype=kind))
        return whole[-1][32 : 32 + size].reshape(shape)

    high = n + (n == 0)
    near = rng.integers(0, high, size=(p, n, k)).astype(np.int32)
    if near.size and rng.random() < 0.15:
        near.flat[wild.below(rng, near.size)] = rng.choice([-1, n, 2**31 - 1, -(2**31)])
    winners = rng.integers(0, high, size=(p, n, c)).astype(np.int16)
    if winners.size and rng.random() < 0.15:
        winners.flat[wild.below(rng, winners.size)] = rng.choice([-1, n, 2**15 - 1])
    if rng.random() < 0.05:
        near = near[:, :, :1].copy()
    calls: dict[str, Callable[[], None]] = {
        "gather_max": lambda: _geom.gather_max(values(p, n, c), near, output(dtype, p, n, c)),
        "gather_max_argmax": lambda: _geom.gather_max_argmax(
            values(p, n, c), near, output(dtype, p, n, c), output(np.int16, p, n, c)
        ),
        "gather_max_backward": lambda: _geom.gather_max_backward(
            values(p, n, c), winners, output(dtype, p, n, c)
        ),
        "gather_sum": lambda: _geom.gather_sum(values(p, n, c), near, output(dtype, p, n, c)),
        "gather_sum_backward": lambda: _geom.gather_sum_backward(
            values(p, n, c), near, output(dtype, p, n, c)
        ),
        "edge_max_leaky": lambda: _geom.edge_max_leaky(
            values(p, n, 2 * c), rng.normal(size=c).astype(np.float32), near, 0.2, output(dtype, p, n, c)
        ),
        "pool_nodes": lambda: _geom.pool_nodes(
            values(p, n, c), output(dtype, p, 2 * c), output(np.int16, p, c)
        ),
        "pool_nodes_backward": lambda: _geom.pool_nodes_backward(
            values(p, 2 * c),
            np.ascontiguousarray(winners[:, 0] if n else np.zeros((p, c), np.int16)),
            output(dtype, p, n, c),
        ),
        "knn": lambda: _geom.knn(values(p, n, c), output(np.int32, p, n, k)),
    }
    try:
        with refusals(*CORE_REFUSALS):
            calls[name]()
    finally:
        for buffer in whole:
            assert (buffer[:32] == 99).all(), "memory before an output was written to"
            assert (buffer[-32:] == 99).all(), "memory behind an output was written to"
    return True


# --- what people call ----------------------------------------------------------------------------------

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

    def move(mesh: Any, _: Any) -> Any:
        with np.errstate(over="ignore"):
            step = rng.normal(size=mesh.vertices.shape) * rng.choice([0.0, 1e-3, 1.0, 1e6])
            return np.clip(
                mesh.vertices + step * max(np.abs(mesh.vertices).max(), 1e-300), -1.7e308, 1.7e308
            ), None

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


# --- files -----------------------------------------------------------------------------------------------


@cache
def seed_files(extension: str) -> tuple[bytes, ...]:
    """Whole files of a format, of several kinds each, to be mutated."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    colored = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    colored.visual.vertex_colors = np.arange(4 * len(ball.vertices), dtype=np.uint8).reshape(-1, 4)
    colored.vertex_attributes["quality"] = np.linspace(0, 1, len(ball.vertices)).astype(np.float32)
    colored.face_attributes["label"] = np.arange(len(ball.faces), dtype=np.int32)
    textured = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    picture = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    textured.visual = trimesh.visual.TextureVisuals(
        uv=np.array(ball.vertices[:, :2]), material=trimesh.visual.material.SimpleMaterial(image=picture)
    )
    if extension == ".ply":
        text = b"""ply
format ascii 1.0
comment TextureFile wood.png
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 4
property list uchar int vertex_indices
property list uchar float texcoord
element edge 1
property int vertex1
property int vertex2
end_header
0 0 0 255 0 0
1 0 0 0 255 0
0 1 0 0 0 255
0 0 1 1 2 3
3 0 2 1 6 0 0 1 0 0 1
3 0 1 3 6 0 0 1 0 0 1
3 0 3 2 6 0 0 1 0 0 1
3 1 2 3 6 0 0 1 0 0 .5
0 1
"""
        return (text, text, *(_saved(mesh, extension) for mesh in (ball, colored, textured)))
    if extension == ".obj":
        text = (
            b"# made by hand\nmtllib a.mtl\no ball\n"
            + b"".join(b"v %d %d %d\n" % tuple(p) for p in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)))
            + b"vt 0 0\nvt 1 0\nvt 0.5 1\nvn 0 0 1\ng a\nusemtl red\nf 1/1/1 3/2/1 2/3/1\nf 1//1 2//1 4//1\n"
            + b"usemtl blue\nf -4 -1 -2\nf 2/1 3/2 4/3\nl 1 2\n"
        )
        return (text, text, *(_saved(mesh, extension) for mesh in (colored, textured)))
    if extension == ".stl":
        far = trimesh.Trimesh(ball.vertices + 1e7, ball.faces, process=False)
        return tuple(_saved(mesh, extension) for mesh in (ball, far))
    if extension == ".off":
        text = (
            b"OFF\n# by hand\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
            b"3 0 2 1 255 0 0\n3 0 1 3 0 255 0\n3 0 3 2 1 2 3\n3 1 2 3 9 9 9\n"
        )
        return (text, *(_saved(mesh, extension) for mesh in (ball, colored)))
    return tuple(_saved(mesh, extension) for mesh in (ball, colored, textured))


def _saved(mesh: trimesh.Trimesh, extension: str) -> bytes:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{extension}"
        save(mesh, path)
        return path.read_bytes()


def mesh_file(extension: str, rng: Rng, folder: Path) -> bool:
    files = seed_files(extension)
    path = folder / f"mutated{extension}"
    path.write_bytes(wild.mutated(rng, files[wild.below(rng, len(files))]))
    with refusals(MeshError):
        mesh = load(path)
    finite(mesh.vertices)
    assert len(mesh.faces)
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    # What was read can be worked on, and written.
    with refusals(GcndError):
        save(apply_filter(mesh, "laplacian", iterations=1), folder / f"written{extension}")
    finite(load(folder / f"written{extension}").vertices)
    return True


def weights_file(rng: Rng, folder: Path) -> bool:
    path = folder / "mutated.safetensors"
    data = tiny_weights(folder).read_bytes()
    header = 8 + int.from_bytes(data[:8], "little")
    if rng.random() < 0.7:
        # The header is a twentieth of the file; faults in it tell more than faults in the weights.
        data = wild.mutated(rng, data[8:header]) + data[header:]
        size = len(data) - (tiny_weights(folder).stat().st_size - header)
        data = (size if rng.random() < 0.9 else wild.below(rng, 1 << 40)).to_bytes(8, "little") + data
    else:
        data = wild.mutated(rng, data)
    path.write_bytes(data)
    with refusals(WeightsError):
        cascade = load_cascade(str(path))
    for tensor in cascade.state_dict().values():
        finite(tensor.detach().double().numpy())
    ball = trimesh.creation.icosphere(subdivisions=1)
    with refusals(GcndError):
        vertices, _ = gcnd.denoise(
            (np.array(ball.vertices), ball.faces), preset=str(path), precision="float32"
        )
    finite(vertices)
    return True


def card_file(rng: Rng, folder: Path) -> bool:
    card = json.loads((registry._FOLDER / "fast.json").read_bytes())
    card["sha256"] = hashlib.sha256(tiny_weights(folder).read_bytes()).hexdigest()
    text = json.dumps(card).encode()
    shipped = folder / "shipped"
    shipped.mkdir(exist_ok=True)
    (shipped / "tiny.safetensors").write_bytes(tiny_weights(folder).read_bytes())
    (shipped / "tiny.json").write_bytes(wild.mutated(rng, text))
    before = registry._FOLDER, registry._SHIPPED
    registry._FOLDER, registry._SHIPPED = shipped, ("tiny",)
    try:
        with refusals(WeightsError):
            (found,) = registry.list_models()
        with refusals(WeightsError):
            load_cascade("tiny")
    finally:
        registry._FOLDER, registry._SHIPPED = before
    assert isinstance(found.sha256, str)
    return True


def log_file(rng: Rng, folder: Path) -> bool:
    line = {
        "time": 1.5,
        "stage": 1,
        "step": 100,
        "loss": 0.1,
        "patches_per_second": 9.0,
        "validation_e_a": 3.0,
    }
    text = "".join(json.dumps(line | {"step": step}) + "\n" for step in range(100, 500, 100))
    (folder / "log.jsonl").write_bytes(wild.mutated(rng, text.encode()))
    with refusals(ConfigError):
        assert read_log(folder)
    return True


def rows_file(rng: Rng, folder: Path) -> bool:
    row = Row(
        "k",
        "cube",
        "cad",
        "normal",
        "0.1",
        768,
        "taubin",
        "taubin",
        "gcnd",
        "1",
        {"x": 1},
        None,
        1.5,
        e_a=3.25,
    )
    line = json.dumps(asdict(row)).encode() + b"\n"
    path = folder / "rows.jsonl"
    path.write_bytes(wild.mutated(rng, line * 3))
    with refusals(ConfigError):
        RowFile(path)
    return True


CASES: dict[str, Case] = {
    "core: topology": topology,
    "core: face geometry": face_geometry,
    "core: weld": weld,
    "core: classes, roughness": classes,
    "core: patches": patches,
    "core: averages, cover": averages,
    "core: refinement": refinement,
    "core: vertex update": vertex_update,
    "core: remesh": remeshing,
    **{f"kernel: {name}": partial(kernel, name) for name in KERNELS},
    **{f"filter: {info.name}": partial(core_filter, info.name) for info in list_filters()},
    "metrics": measures,
    "mesh arrays": arrays,
    "controls": controls,
    "mesh info": info,
    "denoise": denoise,
    **{f"file: {name[1:]}": partial(mesh_file, name) for name in (".ply", ".obj", ".stl", ".off", ".glb")},
    "file: weights": weights_file,
    "file: model card": card_file,
    "file: training log": log_file,
    "file: comparison rows": rows_file,
}


def run_case(name: str, seed: int, number: int, folder: Path) -> bool:
    """Runs one case, the same one for the same arguments; returns whether its input was accepted."""
    rng = np.random.default_rng([seed, number, *name.encode()])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            return CASES[name](rng, folder)
        except Refused:
            return False


__all__ = ["CASES", "run_case", "tiny_cascade", "tiny_weights"]
