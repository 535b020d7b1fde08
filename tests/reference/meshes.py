"""Adjacency and face geometry by definition, and small meshes to compare on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def face_geometry(vertices: Floats, faces: Ints) -> tuple[Floats, Floats, Floats]:
    """Unit normals (F, 3), centroids (F, 3) and areas (F)."""
    normals = np.zeros((len(faces), 3))
    centroids = np.zeros((len(faces), 3))
    areas = np.zeros(len(faces))
    for f, (a, b, c) in enumerate(faces):
        cross = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        length = np.linalg.norm(cross)
        centroids[f] = (vertices[a] + vertices[b] + vertices[c]) / 3
        areas[f] = length / 2
        if length > 0:
            normals[f] = cross / length
    return normals, centroids, areas


def vertex_neighbors(faces: Ints) -> list[set[int]]:
    """For each face the other faces that share at least one vertex with it."""
    faces_of_vertex: dict[int, set[int]] = {}
    for f, face in enumerate(faces):
        for v in face:
            faces_of_vertex.setdefault(int(v), set()).add(f)
    return [set().union(*(faces_of_vertex[int(v)] for v in face)) - {f} for f, face in enumerate(faces)]


def edge_neighbors(faces: Ints) -> list[set[int]]:
    """For each face the other faces that share an edge (two vertices) with it."""
    faces_of_edge: dict[frozenset[int], set[int]] = {}
    edges_of_face = []
    for f, (a, b, c) in enumerate(faces):
        edges = [frozenset((int(p), int(q))) for p, q in ((a, b), (b, c), (c, a)) if p != q]
        edges_of_face.append(edges)
        for edge in edges:
            faces_of_edge.setdefault(edge, set()).add(f)
    return [set().union(*(faces_of_edge[e] for e in edges)) - {f} for f, edges in enumerate(edges_of_face)]


def ring(f: int, n: int, neighbors: list[set[int]]) -> set[int]:
    """Faces reached from `f` in at most `n` steps across shared vertices, without `f`."""
    reached = {f}
    for _ in range(n):
        reached = reached.union(*(neighbors[g] for g in reached))
    return reached - {f}


def mean_centroid_distance(centroids: Floats, adjacent: list[set[int]]) -> float:
    """Mean distance between the centroids of faces that share an edge, each pair once."""
    distances = [
        np.linalg.norm(centroids[f] - centroids[g]) for f, near in enumerate(adjacent) for g in near if g > f
    ]
    return float(np.mean(distances)) if distances else 0.0


def split(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Each face into four at its edge midpoints."""
    points = list(vertices)
    midpoints: dict[frozenset[int], int] = {}

    def midpoint(a: int, b: int) -> int:
        edge = frozenset((a, b))
        if edge not in midpoints:
            midpoints[edge] = len(points)
            points.append((points[a] + points[b]) / 2)
        return midpoints[edge]

    result = []
    for a, b, c in faces.tolist():
        ab, bc, ca = midpoint(a, b), midpoint(b, c), midpoint(c, a)
        result += [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.array(points), np.array(result)


def cube(levels: int) -> tuple[Floats, Ints]:
    """The unit cube, 12 · 4^levels faces."""
    vertices = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], dtype=float)
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])
    for _ in range(levels):
        vertices, faces = split(vertices, faces)
    return vertices, faces


def open_sphere(levels: int) -> tuple[Floats, Ints]:
    """The unit sphere as a split octahedron, 8 · 4^levels faces less those above z = 0.8."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(levels):
        vertices, faces = split(vertices, faces)
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    kept = vertices[faces].mean(axis=1)[:, 2] < 0.8
    return vertices, faces[kept]


def jittered(vertices: Floats, amplitude: float, seed: int) -> Floats:
    """Vertices moved by normally distributed vectors of standard deviation `amplitude`."""
    return vertices + amplitude * np.random.default_rng(seed).standard_normal(vertices.shape)
