"""Patch selection (Eq. 1), tensor voting (Eqs. 2-3) and the patch graph (Sec. 4.3), one face at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .meshes import Floats, Ints, edge_neighbors, face_geometry, ring, vertex_neighbors


@dataclass(frozen=True)
class Alignment:
    """Eq. 2's tensor over Σ μ, its eigenvalues in descending order, and the frame with its sign rules."""

    tensor: Floats
    eigenvalues: Floats
    world_from_patch: Floats
    third_moment: float
    """|Σ_j a_j ((c_j − c_i) · e2)³| over Σ_j a_j |(c_j − c_i) · e2|³; near 0 the sign of e2 is open."""


@dataclass(frozen=True)
class Graph:
    """A patch fixed to `n_nodes`, nearest first."""

    face_ids: Ints
    features: Floats
    neighbors: Ints
    mask: Ints


class PatchReference:
    """All of Sec. 4 for one mesh."""

    def __init__(self, vertices: Floats, faces: Ints, *, patch_scale: float = 4.0, sigma_vote: float = 1 / 3):
        self.vertices, self.faces = vertices, faces
        self.patch_scale, self.sigma_vote = patch_scale, sigma_vote
        self.normals, self.centroids, self.areas = face_geometry(vertices, faces)
        self.touching = vertex_neighbors(faces)
        self.adjacent = edge_neighbors(faces)

    def two_ring(self, i: int) -> list[int]:
        """The face and its 2-ring."""
        return sorted({i} | ring(i, 2, self.touching))

    def mean_area(self, i: int) -> float:
        """ā_i: mean area of the face and its 2-ring."""
        return float(np.mean(self.areas[self.two_ring(i)]))

    def radius(self, i: int) -> float:
        """r = k · sqrt(ā_i)."""
        return self.patch_scale * math.sqrt(self.mean_area(i))

    def select(self, i: int) -> list[int]:
        """Eq. 1, by testing every face; nearest centroid first, ties by face id."""
        r, center = self.radius(i), self.centroids[i]
        chosen = []
        for f, face in enumerate(self.faces):
            if f == i or any(np.linalg.norm(self.vertices[v] - center) < r for v in face):
                chosen.append(f)
        return sorted(chosen, key=lambda f: (f != i, np.linalg.norm(self.centroids[f] - center), f))

    def voted_normal(self, i: int, j: int) -> Floats:
        """n'_j = 2 (n_j · w_j) w_j − n_j with w_j = normalize([(c_j − c_i) × n_j] × (c_j − c_i))."""
        d, n = self.centroids[j] - self.centroids[i], self.normals[j]
        w = np.cross(np.cross(d, n), d)
        length = np.linalg.norm(w)
        if length == 0:
            return np.array(n)
        w = w / length
        return np.array(2 * (n @ w) * w - n)

    def align(self, i: int, region: str = "patch") -> Alignment:
        """Eqs. 2 and 3."""
        patch, r = self.select(i), self.radius(i)
        voters = patch if region == "patch" else self.two_ring(i)
        largest = max(self.areas[j] for j in voters)
        tensor, sum_mu = np.zeros((3, 3)), 0.0
        for j in voters:
            distance = np.linalg.norm(self.centroids[j] - self.centroids[i]) / r
            mu = self.areas[j] / largest * math.exp(-distance / self.sigma_vote)
            vote = self.voted_normal(i, j)
            tensor += mu * np.outer(vote, vote)
            sum_mu += mu
        tensor /= sum_mu
        eigenvalues, eigenvectors = np.linalg.eigh(tensor)
        e1, e2 = eigenvectors[:, 2], eigenvectors[:, 1]
        mean_normal = sum(self.areas[j] * self.normals[j] for j in self.two_ring(i))
        if e1 @ mean_normal < 0:
            e1 = -e1
        along = [((self.centroids[j] - self.centroids[i]) @ e2, self.areas[j]) for j in patch]
        moment = sum(a * x**3 for x, a in along)
        if moment < 0:
            e2 = -e2
        relative = abs(moment) / max(sum(a * abs(x) ** 3 for x, a in along), 1e-300)
        frame = np.stack([e1, e2, np.cross(e1, e2)], axis=1)
        return Alignment(tensor, eigenvalues[::-1], frame, relative)

    def graph(self, i: int, world_from_patch: Floats, n_nodes: int) -> Graph:
        """Sec. 4.3 in a given frame: 17 features a node, up to three neighbours, repeats flagged 0."""
        real = self.select(i)[:n_nodes]
        face_ids = [real[k % len(real)] for k in range(n_nodes)]
        node_of_face = {f: k for k, f in enumerate(real)}
        features, neighbors = np.zeros((n_nodes, 17)), np.zeros((n_nodes, 3), dtype=np.int64)
        for k, j in enumerate(face_ids):
            features[k] = self._features(i, j, world_from_patch)
            present = sorted(node_of_face[f] for f in self.adjacent[j] if f in node_of_face)[:3]
            neighbors[k] = present + [node_of_face[j]] * (3 - len(present))
        mask = np.array([1 if k < len(real) else 0 for k in range(n_nodes)])
        return Graph(np.array(face_ids), features, neighbors, mask)

    def _features(self, i: int, j: int, world_from_patch: Floats) -> Floats:
        r, patch_from_world = self.radius(i), world_from_patch.T
        corners = [self.vertices[v] for v in self.faces[j]]
        distances = [np.linalg.norm(v - self.centroids[i]) for v in corners]
        first = distances.index(min(distances))
        corners = corners[first:] + corners[:first]
        return np.concatenate(
            [
                patch_from_world @ (self.centroids[j] - self.centroids[i]) / r,
                patch_from_world @ self.normals[j],
                [self.areas[j] / self.mean_area(i), len(self.adjacent[j]) / 3],
                *(patch_from_world @ (v - self.centroids[j]) / r for v in corners),
            ]
        )


def face_class(eigenvalues: Floats) -> str:
    """Sec. 5.2's groups, on eigenvalues over their sum."""
    _, second, third = eigenvalues
    if third > 0.1:
        return "corner"
    if second < 0.01 and third < 0.001:
        return "flat"
    if second > 0.01:
        return "edge"
    return "transitional"
