"""Making sure that the faces of a mesh are a surface: each once, touching, and agreed on which side is out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcnd import _geom
from gcnd.mesh_io import MeshArrays
from gcnd.repeats import without_repeats

__all__ = ["Surface", "as_surface"]

_FEWEST_FACES = 8
"""An open piece of fewer is hardly a neighbourhood: a patch of the network has 64."""

_FIRST_LOOK = 1000
"""Faces of which one with an area settles that there is one."""

_ROUNDING = 2.0**-49
"""What three points of a line span at most, rounded, over their largest coordinate."""

_NO_AREA = "no face has an area: the corners of each lie on a line or at one point, and there is no surface"
_MERGE = "vertices that belong together must be at exactly one position; merge them first"


class Surface(NamedTuple):
    """Holds what every method works on.

    Attributes:
        mesh: With each position once, (V, 3), and each face, (F', 3); neighbours agree on which side is out, where
            they can.
        topology: Its adjacency, built once for all steps.
        told: Sentences for whoever owns the mesh, on what is wrong with it; none where all is well.
        place: Of every face of the mesh that came in its row in ``mesh.faces`` (F,); None where both have the same.
    """

    mesh: MeshArrays
    topology: _geom.Topology
    told: tuple[str, ...] = ()
    place: NDArray[np.int64] | None = None

    def of_all_faces(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns values by face of ``mesh`` (F',) as those of the mesh that came in (F,), repeated ones alike."""
        return values if self.place is None else values[self.place]


def as_surface(mesh: MeshArrays) -> Surface:
    """Takes every face once, turns faces so that neighbours agree on which side is out, and says what is wrong.

    Of faces with the same three corners the first stays. In every component, faces that hang together by edges of two
    faces, the direction of the greater part stays.

    Args:
        mesh: With each position once, (V, 3) and (F, 3).

    Returns:
        The mesh, itself where nothing is to be done, else with the same faces in the same order, repeated ones left
        out and some of them turned; its adjacency; what is wrong with it; and where each face is.

    Choice: docs/choices.md#orientation, docs/choices.md#repeated-faces, docs/choices.md#no-neighbourhood.

    Example:
        >>> from gcnd.mesh_io import to_arrays
        >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]
        >>> surface = as_surface(to_arrays((corners, [[0, 1, 2], [1, 2, 3], [1, 4, 3], [2, 1, 0]]))[0])
        >>> surface.mesh.faces.tolist(), surface.place.tolist()
        ([[0, 1, 2], [1, 3, 2], [1, 4, 3]], [0, 1, 2, 0])
        >>> for sentence in surface.told:
        ...     print(sentence)  # doctest: +ELLIPSIS
        1 of 4 faces repeat an earlier one, ...
        the mesh is one open piece of 3 faces: there is hardly a neighbourhood to learn from
        1 of 3 faces are turned against the rest of their component (2 edges disagree): ...
    """
    n_given = len(mesh.faces)
    mesh, place = without_repeats(mesh)
    told = []
    if place is not None:
        told.append(
            f"{n_given - len(mesh.faces):,} of {n_given:,} faces repeat an earlier one, in the same direction or the "
            "other: they are left out for the work, and the result has the faces of the input"
        )
    topology = _geom.Topology(mesh.faces, len(mesh.vertices))
    if not _has_area(mesh):
        told.append(_NO_AREA)
        return Surface(mesh, topology, tuple(told), place)
    told += _hardly_a_neighborhood(topology)
    mesh, topology, turned = _oriented(mesh, topology)
    return Surface(mesh, topology, (*told, *turned), place)


def _oriented(mesh: MeshArrays, topology: _geom.Topology) -> tuple[MeshArrays, _geom.Topology, list[str]]:
    """The mesh with faces turned where they have to be, its adjacency, and what there is to say of that."""
    told: list[str] = []
    if not topology.edge_neighbors()[0][-1]:
        return mesh, topology, told
    is_turned, n_disagreeing, n_left, n_one_sided = _geom.orient(topology)
    n_turned = int(np.count_nonzero(is_turned))
    if n_turned:
        faces = mesh.faces.copy()
        faces[is_turned] = faces[is_turned][:, [0, 2, 1]]
        mesh, topology = MeshArrays(mesh.vertices, faces), _geom.Topology(faces, len(mesh.vertices))
        told.append(
            f"{n_turned:,} of {len(faces):,} faces are turned against the rest of their component "
            f"({n_disagreeing:,} edges disagree): they are turned back for the work, and the result has the faces of "
            "the input"
        )
    if n_one_sided:
        told.append(
            "faces of one-sided components, such as a Möbius strip, cannot agree on which side is out: "
            f"{n_left:,} edges are left in {n_one_sided:,} of them, and results near them may be poor"
        )
    return mesh, topology, told


def _hardly_a_neighborhood(topology: _geom.Topology) -> list[str]:
    """What there is to say where most faces have nothing around them: a sentence, or none."""
    n_faces = topology.n_faces
    offsets, ids = topology.edge_neighbors()
    counts = np.diff(offsets)
    n_alone = int(np.count_nonzero(counts == 0))
    if n_faces > 1 and 2 * n_alone > n_faces:
        who = "none" if n_alone == n_faces else f"only {n_faces - n_alone:,}"
        return [
            f"{who} of the {n_faces:,} faces share an edge with another, so that most have no neighbourhood to learn "
            f"from: {_MERGE}"
        ]
    n_small, n_pieces = _small_pieces(offsets, ids, counts)
    if 2 * n_small <= n_faces:
        return []
    if n_pieces == 1:
        size = "a single face" if n_faces == 1 else f"one open piece of {n_faces} faces"
        return [f"the mesh is {size}: there is hardly a neighbourhood to learn from"]
    who = f"all {n_faces:,}" if n_small == n_faces else f"{n_small:,} of the {n_faces:,}"
    return [
        f"{who} faces are in open pieces of fewer than {_FEWEST_FACES} faces, so that most "
        f"have hardly a neighbourhood to learn from: {_MERGE}"
    ]


def _has_area(mesh: MeshArrays) -> bool:
    """Whether a face spans more than the rounding of its corners' positions explains."""
    for faces in (mesh.faces[:_FIRST_LOOK], mesh.faces[_FIRST_LOOK:]):
        corners = mesh.vertices[faces]
        edges = corners[:, 1:] - corners[:, :1]
        sizes = np.abs(edges).max(axis=(1, 2), initial=0.0)
        is_wide = sizes > 0.0
        corners, edges, sizes = corners[is_wide], edges[is_wide], sizes[is_wide, None, None]
        # In the face's own size: squares must be numbers, whatever the unit.
        spans = np.linalg.norm(np.cross(*(edges / sizes).transpose(1, 0, 2)), axis=1)
        if (spans > _ROUNDING * np.abs(corners / sizes).max(axis=(1, 2), initial=0.0)).any():
            return True
    return False


def _small_pieces(
    offsets: NDArray[np.uint64], ids: NDArray[np.uint32], counts: NDArray[np.uint64]
) -> tuple[int, int]:
    """How many faces are in open pieces of fewer than `_FEWEST_FACES`, pieces being what hangs together by edges.

    Returns:
        That number, 0 where it cannot be that of most faces, and how many pieces there are if it is not 0.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    n_faces = len(counts)
    is_at_rim = counts < 3
    # Of such a piece at least three in seven are at the rim, as of an octahedron less a face; larger pieces have fewer,
    # and are spared the rest.
    if 14 * int(np.count_nonzero(is_at_rim)) <= 3 * n_faces:
        return 0, 0
    links = csr_array(
        (np.ones(len(ids), dtype=np.int8), ids.astype(np.int32), offsets.astype(np.int64)),
        shape=(n_faces, n_faces),
    )
    n_pieces, piece = connected_components(links, directed=False)
    sizes = np.bincount(piece)
    is_open = np.bincount(piece[is_at_rim], minlength=len(sizes)) > 0
    return int(sizes[is_open & (sizes < _FEWEST_FACES)].sum()), int(n_pieces)
