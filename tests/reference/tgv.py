"""Total generalised variation of normals with dense matrices, for small meshes without non-manifold edges.

The operators are built another way than in the core: the neighbour across an edge is rotated about that edge into the
plane of the face, in three dimensions, and gradients are least-squares solutions in three dimensions.
"""

from __future__ import annotations

import numpy as np

from .filters import update_vertices
from .meshes import Floats, Ints, face_geometry

PENALTY = 3.0
SIGMA = 1.5


def inner_edges(faces: Ints) -> list[tuple[int, int, int, int]]:
    """(first face, second face, start, end) of the edges between two faces."""
    first: dict[frozenset[int], tuple[int, int, int]] = {}
    edges = []
    for f, (a, b, c) in enumerate(faces.tolist()):
        for p, q in ((a, b), (b, c), (c, a)):
            key = frozenset((p, q))
            if key in first:
                edges.append((first[key][0], f, *first[key][1:]))
            else:
                first[key] = (f, p, q)
    return edges


def unfolded(point: Floats, start: Floats, axis: Floats, from_normal: Floats, to_normal: Floats) -> Floats:
    """A point after the turn about an edge that brings one face's normal to the other's (Rodrigues)."""
    angle = np.arctan2(np.dot(np.cross(from_normal, to_normal), axis), np.dot(from_normal, to_normal))
    arm = point - start
    along = axis * np.dot(axis, arm)
    return start + along + (arm - along) * np.cos(angle) + np.cross(axis, arm) * np.sin(angle)


def mean_edge_length(vertices: Floats, faces: Ints) -> float:
    edges = {frozenset(pair) for a, b, c in faces.tolist() for pair in ((a, b), (b, c), (c, a))}
    return float(np.mean([np.linalg.norm(np.subtract(*vertices[list(edge)])) for edge in edges]))


def operators(vertices: Floats, faces: Ints) -> tuple[Floats, Floats, Floats]:
    """D (E, F), S (E, 2, E) and the lengths of the edges (E), for vertices in mean edge lengths."""
    normals, centroids, _ = face_geometry(vertices, faces)
    edges = inner_edges(faces)
    difference = np.zeros((len(edges), len(faces)))
    lengths = np.zeros(len(edges))
    axes = np.zeros((len(edges), 3))
    # Of each face: edge, which way V counts, way to the other centroid.
    around: list[list[tuple[int, float, Floats]]] = [[] for _ in faces]
    for e, (f, g, p, q) in enumerate(edges):
        difference[e, f], difference[e, g] = -1, 1
        start, way = vertices[p], vertices[q] - vertices[p]
        lengths[e] = np.linalg.norm(way)
        axes[e] = way / lengths[e]
        for here, there, sign in ((f, g, 1.0), (g, f, -1.0)):
            centroid = unfolded(centroids[there], start, axes[e], normals[there], normals[here])
            around[here].append((e, sign, centroid - centroids[here]))
    jumps = np.zeros((len(edges), 2, len(edges)))
    gradients: list[Floats | None] = []
    for neighbors in around:
        ways = np.array([way for _, _, way in neighbors]).reshape(-1, 3)
        weights = np.array([lengths[e] / np.linalg.norm(way) for e, _, way in neighbors])
        moments = np.linalg.eigvalsh((ways * weights[:, None]).T @ ways)
        if moments[1] * moments[2] <= 1e-3 * (moments[1] + moments[2]) ** 2:
            gradients.append(None)
            continue
        root = np.sqrt(weights)[:, None]
        solution = np.linalg.pinv(root * ways, rcond=1e-6) * root.T
        gradient = np.zeros((3, len(edges)))
        for (e, sign, _), column in zip(neighbors, solution.T, strict=True):
            gradient[:, e] = sign * column
        gradients.append(gradient)
    for e, (f, g, _, _) in enumerate(edges):
        here, there = gradients[f], gradients[g]
        if here is None or there is None:
            continue
        jumps[e, 0] = axes[e] @ there - axes[e] @ here
        # The edge's direction turned by 90 degrees in the plane of each face: outwards from the first.
        jumps[e, 1] = np.cross(axes[e], normals[g]) @ there - np.cross(axes[e], normals[f]) @ here
    return difference, jumps, lengths


def shrunk(values: Floats, by: Floats | float) -> Floats:
    """Rows, flattened to vectors, shortened by so much."""
    size = np.sqrt((values.reshape(len(values), -1) ** 2).sum(axis=1))
    factor = np.maximum(0.0, 1.0 - by / np.maximum(size, 1e-300))
    return values * factor.reshape(-1, *[1] * (values.ndim - 1))


def filter_normals(
    vertices: Floats, faces: Ints, *, alpha1: float, alpha0: float, beta: float, iterations: int
) -> Floats:
    """Face normals (F, 3) that minimise the model, by the augmented Lagrangian."""
    vertices = vertices / mean_edge_length(vertices, faces)
    given, _, areas = face_geometry(vertices, faces)
    difference, jumps, lengths = operators(vertices, faces)
    r_p, r_q = PENALTY * alpha1, PENALTY * alpha0
    flat = jumps.reshape(-1, len(lengths))
    twice = np.repeat(lengths, 2)
    normal_inverse = np.linalg.inv(np.diag(beta * areas) + r_p * difference.T @ np.diag(lengths) @ difference)
    slope_inverse = np.linalg.inv(r_p * np.diag(lengths) + r_q * flat.T @ np.diag(twice) @ flat)
    normals, slopes = given.copy(), np.zeros((len(lengths), 3))
    p, u_p = slopes.copy(), slopes.copy()
    q, u_q = np.zeros((len(lengths), 2, 3)), np.zeros((len(lengths), 2, 3))
    for _ in range(iterations):
        pull = difference.T @ (lengths[:, None] * (slopes + p - u_p))
        normals = normal_inverse @ (beta * areas[:, None] * given + r_p * pull)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        change = difference @ normals
        bend = flat.T @ (twice[:, None] * (q - u_q).reshape(-1, 3))
        slopes = slope_inverse @ (r_p * lengths[:, None] * (change - p + u_p) + r_q * bend)
        weight = np.exp(-((np.linalg.norm(change, axis=1) / SIGMA) ** 4))
        first = change - slopes + u_p
        p = shrunk(first, weight / PENALTY)
        u_p = first - p
        second = (flat @ slopes).reshape(-1, 2, 3) + u_q
        q = shrunk(second, 1 / PENALTY)
        u_q = second - q
    return normals


def denoise(
    vertices: Floats,
    faces: Ints,
    *,
    alpha1: float,
    alpha0: float,
    beta: float,
    normal_iterations: int,
    vertex_iterations: int,
) -> Floats:
    """Positions (V, 3)."""
    normals = filter_normals(
        vertices, faces, alpha1=alpha1, alpha0=alpha0, beta=beta, iterations=normal_iterations
    )
    return update_vertices(vertices, faces, normals, vertex_iterations)
