"""Making sure that the faces of a mesh are a surface: that they touch, and agree on which side is out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gcnd import _geom
from gcnd.mesh_io import MeshArrays

__all__ = ["Surface", "as_surface"]


class Surface(NamedTuple):
    """Holds what every method works on.

    Attributes:
        mesh: With each position once, (V, 3) and (F, 3); neighbours agree on which side is out, where they can.
        topology: Its adjacency, built once for all steps.
        told: Sentences for whoever owns the mesh, on what is wrong with it; none where all is well.
    """

    mesh: MeshArrays
    topology: _geom.Topology
    told: tuple[str, ...] = ()


def as_surface(mesh: MeshArrays) -> Surface:
    """Turns faces so that neighbours agree on which side is out, and says what is wrong with a mesh.

    In every component, faces that hang together by edges of two faces, the direction of the greater part stays.

    Args:
        mesh: With each position once, (V, 3) and (F, 3).

    Returns:
        The mesh, itself where nothing is to be turned, else with the same faces in the same order and some of them
        turned; its adjacency; and what is wrong with it.

    Choice: docs/choices.md#orientation.

    Example:
        >>> from gcnd.mesh_io import to_arrays
        >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]
        >>> surface = as_surface(to_arrays((corners, [[0, 1, 2], [1, 2, 3], [1, 4, 3]]))[0])
        >>> surface.mesh.faces.tolist()
        [[0, 1, 2], [1, 3, 2], [1, 4, 3]]
        >>> print(*surface.told)  # doctest: +ELLIPSIS
        1 of 3 faces are turned against the rest of their component (2 edges disagree): ...
    """
    topology = _geom.Topology(mesh.faces, len(mesh.vertices))
    offsets, _ = topology.edge_neighbors()
    told = _alone(int(np.count_nonzero(np.diff(offsets) == 0)), len(mesh.faces))
    if not offsets[-1]:
        return Surface(mesh, topology, tuple(told))
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
    return Surface(mesh, topology, tuple(told))


def _alone(n_alone: int, n_faces: int) -> list[str]:
    """What there is to say of faces without a neighbour; nothing of a single face, or where most have one."""
    if n_faces == 1 or 2 * n_alone <= n_faces:
        return []
    who = "none" if n_alone == n_faces else f"only {n_faces - n_alone:,}"
    return [
        f"{who} of the {n_faces:,} faces share an edge with another, so that most have no neighbourhood to learn "
        "from: vertices that belong together must be at exactly one position; merge them first"
    ]
