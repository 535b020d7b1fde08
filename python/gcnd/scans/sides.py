"""Which side of a clean mesh is out, whatever the order of its faces' corners says."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from gcnd import _geom
from gcnd.data.noise import AnyFaces, FaceArray, FloatArray
from gcnd.mesh_io import MeshArrays
from gcnd.scans.window import BoolArray
from gcnd.surface import as_surface

_Ids = npt.NDArray[np.int64]

_ROUNDING = 1e-12
"""A smaller volume, as a share of what the tetrahedra could have, is that of a flat body, which stays as it is."""


class Sides(NamedTuple):
    """The directions in which the faces of a mesh look.

    Attributes:
        normals: (F, 3) unit normals, outward where there is an outside; zero of a face without area.
        has_outside: (F,), whether the face belongs to a closed body.
    """

    normals: FloatArray
    has_outside: BoolArray

    def towards(self, face_ids: npt.NDArray[np.integer], directions: FloatArray) -> FloatArray:
        """Returns the normals (N, 3) of faces (N,): of those without an outside, on the side of directions (N, 3).

        Example:
            >>> up = np.array([[0.0, 0, 1], [0, 0, 1]])
            >>> Sides(up, np.array([True, False])).towards(np.array([0, 1]), -up)[:, 2].tolist()
            [1.0, -1.0]
        """
        normals = self.normals[face_ids]
        away = ~self.has_outside[face_ids] & (np.einsum("nx,nx->n", normals, directions) < 0)
        return np.asarray(np.where(away[:, None], -normals, normals))


def find_sides(vertices: FloatArray, faces: AnyFaces) -> Sides:
    """Finds which side of every face is out.

    First neighbours are made to agree, see `gcnd.surface.as_surface`. Of the bodies, faces that hang together by edges
    of two faces, those without a boundary then have an inside. One that lies in no other is turned if the volume that
    it encloses is negative, and what lies in it turns along: a cavity looks to its inside as it did before, and a body
    of positive volume in no other stays as it is, with all in it.

    Args:
        vertices: (V, 3) float64; a position may be there more than once.
        faces: (F, 3), vertex ids.

    Returns:
        The normals, and which faces have an outside.

    Choice: docs/choices.md#truth-of-a-fused-scan.

    Example:
        >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> inside_out = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
        >>> sides = find_sides(corners, inside_out)
        >>> float(sides.normals[0, 2]), sides.has_outside.tolist()
        (-1.0, [True, True, True, True])
    """
    given = MeshArrays(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.uint32)
    )
    once, _ = given.welded()
    surface = as_surface(once)
    agreeing = surface.mesh.faces
    edges = _edges(agreeing)
    body = _bodies(edges, len(agreeing))
    is_closed = _without_boundary(edges, body)
    normals = _geom.face_geometry(once.vertices, agreeing)[0]
    normals[_inside_out(once.vertices[agreeing], body, is_closed)[body]] *= -1
    # A repeated face has the side of the first one.
    rows = slice(None) if surface.place is None else surface.place
    return Sides(normals[rows], is_closed[body][rows])


class _Edges(NamedTuple):
    """The sides of faces, (S,) each: whose it is, which edge it lies on, and +1 or −1 as it runs along that."""

    face_ids: _Ids
    edge: _Ids
    direction: _Ids


def _edges(faces: FaceArray) -> _Edges:
    """Faces that use a vertex twice have none: they join nothing."""
    proper = np.flatnonzero((faces != np.roll(faces, 1, axis=1)).all(axis=1))
    ends = faces[proper][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    low, high = ends.min(axis=1), ends.max(axis=1)
    edge = np.unique(low * (int(faces.max(initial=0)) + 1) + high, return_inverse=True)[1]
    return _Edges(np.repeat(proper, 3), edge.reshape(-1), np.where(ends[:, 0] < ends[:, 1], 1, -1))


def _bodies(edges: _Edges, n_faces: int) -> _Ids:
    """(F,): the number of each face's body."""
    order = np.argsort(edges.edge, kind="stable")
    counts = np.bincount(edges.edge)
    first = (np.cumsum(counts) - counts)[counts == 2]
    ends = edges.face_ids[order[first]], edges.face_ids[order[first + 1]]
    graph = sparse.coo_array((np.ones(len(first)), ends), shape=(n_faces, n_faces))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _without_boundary(edges: _Edges, body: _Ids) -> BoolArray:
    """(B,): whether a body's faces run through each of its edges as often in one direction as in the other."""
    n_bodies = int(body.max()) + 1
    own = body[edges.face_ids]
    _, places = np.unique(edges.edge * n_bodies + own, return_inverse=True)
    balance = np.bincount(places.reshape(-1), weights=edges.direction)
    is_closed = np.ones(n_bodies, dtype=bool)
    is_closed[own[balance[places.reshape(-1)] != 0]] = False
    return is_closed


def _inside_out(corners: FloatArray, body: _Ids, is_closed: BoolArray) -> BoolArray:
    """(B,): which bodies are to be turned, of faces (F, 3, 3)."""
    first, across = corners[:, 0], np.cross(corners[:, 1], corners[:, 2])
    volume = np.bincount(body, weights=np.einsum("fx,fx->f", first, across) / 6)
    most = np.bincount(body, weights=np.linalg.norm(first, axis=1) * np.linalg.norm(across, axis=1) / 6)
    is_negative = is_closed & (volume < -_ROUNDING * most)
    if not is_negative.any():
        return is_negative
    by_body = np.split(corners[np.argsort(body, kind="stable")], np.cumsum(np.bincount(body))[:-1])
    low = np.array([own.min(axis=(0, 1)) for own in by_body])
    high = np.array([own.max(axis=(0, 1)) for own in by_body])
    turned = is_negative.copy()
    for own in np.flatnonzero(is_closed):
        around = is_closed & (np.abs(volume) > abs(volume[own]))
        around &= (low < low[own]).all(axis=1) & (high > high[own]).all(axis=1)
        for other in sorted(np.flatnonzero(around), key=lambda other: -abs(volume[other])):
            if _lies_in(by_body[own], by_body[other]):
                turned[own] = is_negative[other]
                break
    return turned


def _lies_in(inner: FloatArray, outer: FloatArray) -> bool:
    """Whether the six outermost points of faces (F, 3, 3) lie inside of closed ones, by their winding numbers.

    The solid angle of a triangle is that of van Oosterom and Strackee 1983.
    """
    points = inner.reshape(-1, 3)
    for point in points[[*points.argmin(axis=0), *points.argmax(axis=0)]]:
        a, b, c = np.moveaxis(outer - point, 1, 0)
        length_a, length_b, length_c = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        above = np.einsum("fx,fx->f", a, np.cross(b, c))
        below = length_a * length_b * length_c
        for u, v, length in ((a, b, length_c), (b, c, length_a), (c, a, length_b)):
            below += np.einsum("fx,fx->f", u, v) * length
        if abs(np.arctan2(above, below).sum()) < np.pi:
            return False
    return True
