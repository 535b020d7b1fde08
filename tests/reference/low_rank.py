"""Non-local low-rank normal filtering (Li et al. 2018), vertex by vertex, with numpy's singular value decomposition."""

from __future__ import annotations

import numpy as np

from .filters import refine_normals, update_vertices
from .meshes import Floats, Ints, face_geometry


def shrink(matrix: Floats, sigma: float) -> tuple[Floats, int]:
    """A matrix (K, N) with its singular values shrunk, but for the means of its rows, and how many remain."""
    means = matrix.mean(axis=1, keepdims=True)
    n_columns = matrix.shape[1]
    left, values, right = np.linalg.svd(matrix - means, full_matrices=False)
    signal = np.sqrt(np.maximum(values**2 - n_columns * sigma**2, 0))
    weights = 2.8 * np.sqrt(2) * np.sqrt(n_columns) * sigma**2 / (signal + 1e-5)
    kept = np.maximum(values - weights, 0)
    return means + left @ np.diag(kept) @ right, int((kept > 0).sum())


def _unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _rings(v: int, near: list[set[int]], most: int) -> list[list[int]]:
    """Vertices by steps from `v`: [v], its neighbours, theirs, …"""
    rings, seen = [[v]], {v}
    while len(rings) <= most:
        ring = set().union(*(near[u] for u in rings[-1])) - seen
        if not ring:
            break
        rings.append(sorted(ring))
        seen |= ring
    return rings


def _patch(
    v: int, near: list[set[int]], vertices: Floats, guides: Floats, size: int
) -> tuple[list[int], Floats]:
    """The patch's vertices in order, and its frame (columns)."""
    rings, count = [], 0
    for ring in _rings(v, near, len(vertices)):
        by_distance = sorted(ring, key=lambda u: float(np.linalg.norm(vertices[u] - vertices[v])))
        rings.append(by_distance[: size - count])
        count += len(rings[-1])
        if count == size:
            break
    members = [u for ring in rings for u in ring]
    _, vectors = np.linalg.eigh(guides[members].T @ guides[members])
    first, second = vectors[:, 2], vectors[:, 1]
    first = first * np.sign(guides[members].sum(axis=0) @ first)
    second = second * np.sign(((guides[members] @ second) ** 3).sum())
    frame = np.stack([first, second, np.cross(first, second)], axis=1)

    def angle(u: int) -> float:
        _, y, z = (vertices[u] - vertices[v]) @ frame
        return float(np.arctan2(z, y))

    return [u for ring in rings for u in sorted(ring, key=angle)], frame


def _covariance(normals: Floats, frame: Floats) -> Floats:
    local = (normals - _unit(normals.sum(axis=0))) @ frame
    return local.T @ local


def _recover(
    v: int,
    alike: list[int],
    patches: list[tuple[list[int], Floats]],
    normals: Floats,
    sums: Floats,
    sigma: float,
) -> None:
    """Adds the recovered normals of a vertex's group to those of all vertices."""
    group = np.stack([normals[patches[u][0]] @ patches[u][1] for u in alike], axis=1)
    for axis in range(3):
        recovered, rank = shrink(group[:, :, axis], sigma)
        group[:, :, axis] = recovered * max(len(group) - rank, 1) / len(group)
    for column, u in enumerate(alike):
        members, frame = patches[u]
        sums[members] += group[:, column] @ frame.T


def denoise(
    vertices: Floats,
    faces: Ints,
    *,
    sigma_m: float = 0.2,
    similar_patches: int = 10,
    patch_size: int = 50,
    search_rings: int = 10,
    vertex_iterations: int = 10,
    fixed_step: bool = False,
) -> Floats:
    """Vertex positions (V, 3) after one pass over the normals."""
    face_normals = face_geometry(vertices, faces)[0]
    guided = refine_normals(vertices, faces, face_normals, iterations=10, sigma_r=sigma_m)
    near: list[set[int]] = [set() for _ in vertices]
    normals, guides = np.zeros_like(vertices), np.zeros_like(vertices)
    for face, normal, guide in zip(faces, face_normals, guided, strict=True):
        for v in face:
            near[v] |= {int(u) for u in face} - {int(v)}
            normals[v] += normal
            guides[v] += guide
    normals, guides = _unit(normals), _unit(guides)
    patches = [_patch(v, near, vertices, guides, patch_size) for v in range(len(vertices))]
    shapes = [[_covariance(n[members], frame) for n in (normals, guides)] for members, frame in patches]
    sums = np.zeros_like(vertices)
    for v in range(len(vertices)):

        def unlikeness(u: int, v: int = v) -> float:
            squares = [((a - b) ** 2).sum() for a, b in zip(shapes[u], shapes[v], strict=True)]
            return -1.0 if u == v else float(squares[0] * squares[1])

        around = [u for ring in _rings(v, near, search_rings) for u in ring]
        alike = sorted((u for u in around if len(patches[u][0]) == len(patches[v][0])), key=unlikeness)
        _recover(v, alike[:similar_patches], patches, normals, sums, sigma_m)
    filtered = _unit(_unit(sums)[faces].sum(axis=1))
    if not fixed_step:
        return update_vertices(vertices, faces, filtered, vertex_iterations)
    for _ in range(vertex_iterations):
        vertices = _moved_by_eighteenths(vertices, faces, filtered)
    return vertices


def _moved_by_eighteenths(vertices: Floats, faces: Ints, normals: Floats) -> Floats:
    """One pass of the authors' program: 1/18 of n (n . (v_j - v_i)) over a vertex's faces and their two edges at it."""
    moved = vertices.copy()
    for face, normal in zip(faces, normals, strict=True):
        for i in face:
            for j in face:
                moved[i] += normal * (normal @ (vertices[j] - vertices[i])) / 18
    return moved
