"""Normal refinement (Eq. 5), vertex updating (Eq. 6) and E_a (Eq. 7), face by face."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from .meshes import Floats, Ints, edge_neighbors, face_geometry, mean_centroid_distance, vertex_neighbors


def _within_radius(f: int, centroids: Floats, radius: float, touching: list[set[int]]) -> set[int]:
    """Faces with centroids within `radius` of face `f`'s, reached breadth first over such faces."""
    inside, seen, queue = set(), {f}, deque([f])
    while queue:
        for g in touching[queue.popleft()] - seen:
            seen.add(g)
            if np.linalg.norm(centroids[g] - centroids[f]) <= radius:
                inside.add(g)
                queue.append(g)
    return inside


def neighborhoods(vertices: Floats, faces: Ints, name: str, radius: float = 2.0) -> list[set[int]]:
    """Ω of every face, the face itself included; `radius` in mean centroid distances."""
    if name == "shared_edge":
        near = edge_neighbors(faces)
    elif name == "shared_vertex":
        near = vertex_neighbors(faces)
    else:
        _, centroids, _ = face_geometry(vertices, faces)
        length = radius * mean_centroid_distance(centroids, edge_neighbors(faces))
        touching = vertex_neighbors(faces)
        near = [_within_radius(f, centroids, length, touching) for f in range(len(faces))]
    return [{f} | others for f, others in enumerate(near)]


def refine_normals(
    vertices: Floats,
    faces: Ints,
    normals: Floats,
    *,
    iterations: int,
    sigma_r: float = 0.3,
    sigma_s: float | None = None,
    neighborhood: str = "shared_vertex",
    radius: float = 2.0,
) -> Floats:
    """Eq. 5, `iterations` times; a zero normal takes the mean under a_j · W_s."""
    _, centroids, areas = face_geometry(vertices, faces)
    if sigma_s is None:
        sigma_s = mean_centroid_distance(centroids, edge_neighbors(faces))
    omega = neighborhoods(vertices, faces, neighborhood, radius)
    current = normals.copy()
    for _ in range(iterations):
        refined = current.copy()
        for i in range(len(faces)):
            total = np.zeros(3)
            for j in omega[i]:
                weight = areas[j] * math.exp(
                    -(np.linalg.norm(centroids[j] - centroids[i]) ** 2) / (2 * sigma_s**2)
                )
                if current[i].any():
                    weight *= math.exp(-(np.linalg.norm(current[j] - current[i]) ** 2) / (2 * sigma_r**2))
                total += weight * current[j]
            if total.any():
                refined[i] = total / np.linalg.norm(total)
        current = refined
    return current


def update_vertices(vertices: Floats, faces: Ints, normals: Floats, iterations: int) -> Floats:
    """Eq. 6, `iterations` times: face by face, corner by corner, edge by edge."""
    current = vertices.copy()
    for _ in range(iterations):
        pull = np.zeros_like(current)
        n_faces = np.zeros(len(current))
        for face, n in zip(faces, normals, strict=True):
            for i in face:
                n_faces[i] += 1
                for j in face:
                    if j != i:
                        pull[i] += n * (n @ (current[j] - current[i]))
        current = current + pull / (3 * np.maximum(n_faces, 1))[:, None]
    return current


def fit_vertices(vertices: Floats, faces: Ints, normals: Floats, first: Floats) -> tuple[Floats, Floats]:
    """The least E of `fit_vertices`, edge by edge, then vertex by vertex, as one dense system.

    Returns its solution (V, 3) and its matrix (3 V, 3 V), by which E grows around it.
    """
    n = len(vertices)
    mean_edge = np.mean([np.linalg.norm(vertices[a] - vertices[b]) for a, b in edges_once(faces)])
    x, r = vertices / mean_edge, first / mean_edge
    corners = x[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    matrix, means = np.zeros((3 * n, 3 * n)), np.zeros((n, 3))
    for face, normal, area in zip(faces, normals, areas, strict=True):
        for k in range(3):
            i, j, opposite = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            half_cot = (x[i] - x[opposite]) @ (x[j] - x[opposite]) / (4 * area)
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                block = np.s_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
                matrix[block] += sign * half_cot * np.outer(normal, normal)
            means[i] += area * normal
    heights = np.empty(n)
    for i in range(n):
        length = np.linalg.norm(means[i])
        means[i] = means[i] / length if length > 0 else 0.0
        heights[i] = means[i] @ (r - x)[i]
    sizes = np.sort(np.abs(heights[np.unique(faces)]))
    sigma = 1.4826 * sizes[(len(sizes) - 1) // 2]
    right = np.zeros(3 * n)
    for i in range(n):
        pull = 0.0026 / max(sigma, 0.02) / (1 + (heights[i] / (3 * sigma)) ** 2)
        along = np.outer(means[i], means[i])
        hold = pull * along + 0.13 * (np.eye(3) - along)
        matrix[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += hold
        right[3 * i : 3 * i + 3] = hold @ r[i]
    fitted = np.linalg.solve(matrix, right).reshape(n, 3) * mean_edge
    alone = np.setdiff1d(np.arange(n), faces)
    fitted[alone] = vertices[alone]
    return fitted, matrix


def keep_detail(vertices: Floats, faces: Ints, moved: Floats) -> Floats:
    """Steps back where they are larger than elsewhere and alike from vertex to vertex, a vertex at a time."""
    lengths = [np.linalg.norm(vertices[f[k]] - vertices[f[k - 1]]) for f in edges_once(faces) for k in (1,)]
    steps = (moved - vertices) / np.mean(lengths)
    around: list[list[int]] = [[] for _ in vertices]
    for number, face in enumerate(faces):
        for i in face:
            around[i].append(number)
    pairs = ((0, 1), (1, 2), (2, 0))
    of_faces = [
        (
            sum(steps[f[i]] @ steps[f[j]] for i, j in pairs) / 3,
            sum(steps[i] @ steps[i] for i in f) / 3,
        )
        for f in faces
    ]
    means, sizes = np.array(of_faces), np.zeros(0)
    for rounds in range(49):
        of_vertices = np.array([means[a].mean(axis=0) if a else np.zeros(2) for a in around])
        if rounds == 16:
            sizes = of_vertices[:, 1]
        means = np.array([of_vertices[f].mean(axis=0) for f in faces])
    ordered = sorted(sizes[[bool(a) for a in around]])
    noise = ordered[int((len(ordered) - 1) * 0.05)]
    kept = moved.copy()
    for i, (product, square) in enumerate(of_vertices):
        even = min(1.0, 2 * noise / sizes[i]) ** 2 if sizes[i] > 0 else 1.0
        t = min(1.0, max(0.0, ((product / square if square > 0 else 0.0) - 0.04) / 0.08))
        u = min(1.0, max(0.0, (np.sqrt(noise) - 0.06) / 0.06))
        taken_back = t * t * (3 - 2 * t) * (1 - u * u * (3 - 2 * u))
        kept[i] = vertices[i] + max(even, 1 - taken_back) * (moved[i] - vertices[i])
    return kept


def edges_once(faces: Ints) -> list[tuple[int, int]]:
    """Every edge of the faces, its ends in rising order."""
    return sorted({(min(f[k - 1], f[k]), max(f[k - 1], f[k])) for f in faces for k in range(3)})


def average_of_centroids(vertices: Floats, faces: Ints) -> Floats:
    """Every vertex at the mean of the centroids of its faces, one face after the other."""
    total, count = np.zeros_like(vertices), np.zeros(len(vertices))
    for face in faces:
        for v in face:
            total[v] += vertices[face].mean(axis=0)
            count[v] += 1
    return np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], vertices)


def mesh_roughness(vertices: Floats, faces: Ints) -> Floats:
    """Quantiles of |n · (M − 1)² v| over the vertices, M the mean of the centroids of a vertex's faces."""
    once = average_of_centroids(vertices, faces) - vertices
    twice = average_of_centroids(once, faces) - once
    normals, _, areas = face_geometry(vertices, faces)
    sizes = []
    for v in sorted(set(faces.ravel().tolist())):
        normal = sum(normals[f] * areas[f] for f in range(len(faces)) if v in faces[f])
        sizes.append(abs(float(normal @ twice[v])) / float(np.linalg.norm(normal)))
    ordered = np.sort(sizes)
    return np.array([ordered[int((len(ordered) - 1) * share)] for share in (0.1, 0.25, 0.5, 0.9)])


def normal_error(result: Floats, truth: Floats) -> float:
    """E_a in degrees: the mean of acos(n_i · ñ_i)."""
    angles = [math.acos(min(1.0, max(-1.0, float(a @ b)))) for a, b in zip(result, truth, strict=True)]
    return math.degrees(sum(angles) / len(angles))
