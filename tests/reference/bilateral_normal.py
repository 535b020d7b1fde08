"""Bilateral normal filtering for mesh denoising (Zheng et al. 2011, local scheme), the classical baseline.

The same bilateral filter as Eq. 5 on the noisy mesh's own normals, then the vertex updating of Eq. 6, written
with sparse matrices so that 20 thousand faces take seconds. Two details follow the program of the
guided-normal-filtering authors, whose errors it reproduces: a face is not its own neighbour, and boundary
vertices stay.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from .meshes import Floats, Ints


def _geometry(vertices: Floats, faces: Ints) -> tuple[Floats, Floats, Floats]:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-300)[:, None], (a + b + c) / 3, length / 2


def _incidence(faces: Ints, n_vertices: int) -> sparse.csr_matrix:
    """(F, V): 1 where a face uses a vertex."""
    rows = np.repeat(np.arange(len(faces)), 3)
    shape = (len(faces), n_vertices)
    return sparse.csr_matrix((np.ones(3 * len(faces)), (rows, faces.ravel())), shape=shape)


def _boundary_vertices(faces: Ints, n_vertices: int) -> np.ndarray:
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    on_boundary = np.zeros(n_vertices, dtype=bool)
    on_boundary[unique[count == 1].ravel()] = True
    return on_boundary


def filter_normals(
    vertices: Floats, faces: Ints, *, sigma_r: float, iterations: int, include_center: bool = False
) -> Floats:
    """Face normals (F, 3) after the local scheme; σ_s is the mean distance of adjacent centroids."""
    normals, centroids, areas = _geometry(vertices, faces)
    incidence = _incidence(faces, len(vertices))
    shared = (incidence @ incidence.T).tocoo()
    i, j, common = shared.row, shared.col, shared.data
    distance = np.linalg.norm(centroids[i] - centroids[j], axis=1)
    sigma_s = distance[(common == 2) & (i != j)].mean()
    keep = (i != j) | include_center
    i, j, distance = i[keep], j[keep], distance[keep]
    spatial = areas[j] * np.exp(-(distance**2) / (2 * sigma_s**2))
    for _ in range(iterations):
        change = np.sum((normals[i] - normals[j]) ** 2, axis=1)
        weight = spatial * np.exp(-change / (2 * sigma_r**2))
        total = sparse.csr_matrix((weight, (i, j)), shape=shared.shape) @ normals
        normals = total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]
    return normals


def move_vertices(
    vertices: Floats, faces: Ints, normals: Floats, *, iterations: int, fix_boundary: bool = True
) -> Floats:
    """Vertex positions (V, 3) after Eq. 6; the two edges of a face at v add up to 3 (c − v)."""
    incidence = _incidence(faces, len(vertices))
    n_faces = np.maximum(np.asarray(incidence.sum(axis=0)).ravel(), 1)
    corner_vertices, corner_faces = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    fixed = _boundary_vertices(faces, len(vertices)) if fix_boundary else np.zeros(len(vertices), dtype=bool)
    current = vertices.copy()
    for _ in range(iterations):
        centroids = current[faces].mean(axis=1)
        n = normals[corner_faces]
        height = np.sum(n * (centroids[corner_faces] - current[corner_vertices]), axis=1)
        pull = np.zeros_like(current)
        np.add.at(pull, corner_vertices, n * height[:, None])
        pull[fixed] = 0
        current = current + pull / n_faces[:, None]
    return current


def denoise(
    vertices: Floats,
    faces: Ints,
    *,
    sigma_r: float = 0.35,
    normal_iterations: int = 20,
    vertex_iterations: int = 20,
) -> Floats:
    """Vertex positions (V, 3) of the mesh denoised by bilateral normal filtering."""
    normals = filter_normals(vertices, faces, sigma_r=sigma_r, iterations=normal_iterations)
    return move_vertices(vertices, faces, normals, iterations=vertex_iterations)
