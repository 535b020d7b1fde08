"""Counting what a mesh is made of and what is unusual about it."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["MeshInfo", "mesh_info"]

_COLLAPSED_SINE = 2.0**-48
"""Sine between two edges up to which rounding alone explains it; the geometry core uses the same."""


class MeshInfo(TypedDict):
    """What `mesh_info` counts; lengths in mesh units."""

    vertices: int
    faces: int
    boundary_edges: int
    non_manifold_edges: int
    misoriented_edges: int
    components: int
    isolated_vertices: int
    zero_area_faces: int
    duplicate_faces: int
    duplicate_vertices: int
    bounding_box_diagonal: float
    mean_edge_length: float
    edge_length_variation: float
    watertight: bool


def mesh_info(vertices: ArrayLike, faces: ArrayLike) -> MeshInfo:
    """Counts the parts of a mesh and its defects.

    Edges and components are those of the surface as denoising sees it: vertices at exactly one position are
    one vertex, as STL files and texture seams repeat them, and a face with two corners at one position has
    no edges.

    Args:
        vertices: (V, 3), finite, mesh units.
        faces: int (F, 3), vertex ids below V.

    Returns:
        A dict with, in this order:

        - `vertices`, `faces`: V and F.
        - `boundary_edges`: edges of one face. `non_manifold_edges`: edges of three or more.
        - `misoriented_edges`: edges of two faces that disagree on which side is out, as both run along it the same way.
        - `components`: sets of faces that hang together by shared vertices.
        - `isolated_vertices`: vertices of no face.
        - `zero_area_faces`: faces whose corners lie on a line or a point.
        - `duplicate_faces`: faces with the same three corners as an earlier face, in any order.
        - `duplicate_vertices`: vertices at the position of an earlier vertex.
        - `bounding_box_diagonal`: of all vertices. `mean_edge_length`: of all edges, each counted once.
        - `edge_length_variation`: standard deviation of the edge lengths over their mean; 0.1 for even triangles, 0.5
            for a mesh thinned out.
        - `watertight`: whether every edge belongs to exactly two faces, and there is one.

    Example:
        >>> info = mesh_info([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> info["boundary_edges"], info["watertight"]
        (3, False)
    """
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    corners = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    welded, n_welded = _weld(points)
    is_used = np.zeros(len(points), dtype=bool)
    is_used[corners.ravel()] = True

    triangles = np.sort(welded[corners], axis=1)
    is_collapsed = (triangles[:, 0] == triangles[:, 1]) | (triangles[:, 1] == triangles[:, 2])
    edges, faces_per_edge, directions = _edges(welded[corners][~is_collapsed])
    position = np.empty((n_welded, 3))
    position[welded] = points
    lengths = np.linalg.norm(position[edges[:, 0]] - position[edges[:, 1]], axis=1)
    boundary = int(np.count_nonzero(faces_per_edge == 1))
    non_manifold = int(np.count_nonzero(faces_per_edge > 2))
    return MeshInfo(
        vertices=len(points),
        faces=len(corners),
        boundary_edges=boundary,
        non_manifold_edges=non_manifold,
        misoriented_edges=int(np.count_nonzero((faces_per_edge == 2) & (np.abs(directions) == 2))),
        components=_count_components(triangles, n_welded),
        isolated_vertices=int(np.count_nonzero(~is_used)),
        zero_area_faces=int(np.count_nonzero(_is_without_area(points, corners))),
        duplicate_faces=len(triangles) - len(np.unique(triangles, axis=0)),
        duplicate_vertices=len(points) - n_welded,
        bounding_box_diagonal=float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0,
        mean_edge_length=float(lengths.mean()) if len(lengths) else 0.0,
        edge_length_variation=float((lengths / lengths.mean()).std()) if lengths.any() else 0.0,
        watertight=len(edges) > 0 and boundary == 0 and non_manifold == 0,
    )


def _weld(points: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
    """Id of each vertex's position (V,), and how many positions there are; −0 is 0."""
    clean = points + 0.0
    order = np.lexsort(clean.T)
    ordered = clean[order]
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    welded = np.empty(len(points), dtype=np.int64)
    welded[order] = np.cumsum(is_new) - 1
    return welded, int(is_new.sum())


def _edges(
    triangles: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Unique edges (E, 2), the faces at each (E,), and how many more of these run up than down in ids (E,)."""
    begin, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    # One integer per edge sorts several times faster than rows.
    width = int(triangles.max(initial=0)) + 1
    keys, place, counts = np.unique(
        np.minimum(begin, end) * width + np.maximum(begin, end), return_inverse=True, return_counts=True
    )
    upwards = np.bincount(place, np.where(begin < end, 1.0, -1.0), len(keys)).astype(np.int64)
    return np.column_stack([keys // width, keys % width]), counts, upwards


def _count_components(triangles: NDArray[np.int64], n_vertices: int) -> int:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(triangles):
        return 0
    rows, columns = triangles[:, [0, 1]].T.ravel(), triangles[:, [1, 2]].T.ravel()
    links = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n_vertices, n_vertices))
    _, component = connected_components(links.tocsr(), directed=False)
    return len(np.unique(np.asarray(component)[triangles[:, 0]]))


def _is_without_area(points: NDArray[np.float64], corners: NDArray[np.int64]) -> NDArray[np.bool_]:
    edge1 = points[corners[:, 1]] - points[corners[:, 0]]
    edge2 = points[corners[:, 2]] - points[corners[:, 0]]
    length1, length2 = (np.linalg.norm(edge, axis=1, keepdims=True) for edge in (edge1, edge2))
    # Edges are scaled to unit length first, so that tiny and huge meshes neither underflow nor overflow.
    with np.errstate(invalid="ignore", divide="ignore"):
        sine = np.linalg.norm(np.cross(edge1 / length1, edge2 / length2), axis=1)
    is_without: NDArray[np.bool_] = ~(sine > _COLLAPSED_SINE)
    return is_without
