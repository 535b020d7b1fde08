"""Sums over the faces around a face."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gcnd import _geom

__all__ = ["sum_across_edges"]


def sum_across_edges(topology: _geom.Topology, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums values over the faces across the edges of each face, itself left out: s_f = Σ_{g ∈ N(f)} x_g.

    Args:
        topology: Adjacency of the mesh.
        values: By face (F,).

    Returns:
        (F,).

    Example:
        >>> topology = _geom.Topology(np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32), 4)
        >>> sum_across_edges(topology, np.array([1.0, 5.0])).tolist()
        [5.0, 1.0]
    """
    offsets, ids = topology.edge_neighbors()
    counts = np.diff(offsets.astype(np.int64)).astype(np.int64)
    owner = np.repeat(np.arange(topology.n_faces), counts)
    sums: NDArray[np.float64] = np.bincount(owner, values[ids], topology.n_faces).astype(np.float64)
    return sums
