"""One function for each entry of the compiled core; see `fuzz_cases`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import wild
from fuzz_checks import CORE_REFUSALS, finite, refusals, unit_or_zero
from wild import Rng

from gcnd import _geom, metrics
from gcnd.errors import GcndError
from gcnd.filters import apply_filter, list_filters


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
    is_turned, *counts = _geom.orient(found)
    assert len(is_turned) == len(faces)
    assert min(counts) >= 0
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
        spikes, feet, _ = _geom.find_spikes(topology_of(vertices, faces), vertices)
        flat = _geom.flat_share(topology_of(vertices, faces), vertices, wild.number(rng))
    assert (found <= 3).all()
    assert 0 <= flat <= 1
    assert not np.isnan(roughness).any()
    assert (np.diff(spikes.astype(np.int64)) > 0).all()
    finite(feet)
    return True


def patches(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    n = int(rng.choice([16, 32, 64, 0, 15, 513])) if rng.random() < 0.3 else 16
    options: dict[str, Any] = {
        "n_nodes": n,
        "budget": str(rng.choice(["nearest", "random"])),
        "sheets": str(rng.choice(["all", "one"])),
        "voting_region": str(rng.choice(["patch", "two_ring", "nobody"])),
        "vertex_offsets": bool(rng.random() < 0.5),
        "scale_space": bool(rng.random() < 0.3),
        "first": wild.mesh(rng)[0] if rng.random() < 0.1 else vertices if rng.random() < 0.3 else None,
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


def vertex_fit(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    normals = wild.normals(rng, len(faces))
    first = vertices + rng.normal(size=vertices.shape) * 10.0 ** rng.uniform(-6, 2)
    with refusals(*CORE_REFUSALS):
        found = _geom.fit_vertices(topology_of(vertices, faces), vertices, normals, first)
    assert found.shape == vertices.shape
    finite(found)
    return True


def detail(rng: Rng, _: Path) -> bool:
    vertices, faces = wild.mesh(rng)
    moved = vertices + rng.normal(size=vertices.shape) * 10.0 ** rng.uniform(-6, 2)
    with refusals(*CORE_REFUSALS):
        found = _geom.keep_detail(topology_of(vertices, faces), vertices, moved)
    assert found.shape == vertices.shape
    if np.isfinite(vertices).all() and np.abs(vertices).max() < 1e100:
        finite(found)
        low, high = np.minimum(vertices, moved), np.maximum(vertices, moved)
        slack = 1e-12 * (1 + np.abs(high) + np.abs(low))
        assert np.all((found >= low - slack) & (found <= high + slack))
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
