"""Where the work on a mesh starts: around the origin, without what lies far off the surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd import _geom
from gcnd.spikes import Spikes

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Start", "lengths", "mean_edge_length", "near_1"]

USUAL = (1e-30, 1e30)
"""Largest coordinates between which a mesh keeps its unit: products of some ten lengths are numbers there."""


class Start:
    """Positions to work from, and the way back to those of the mesh.

    Far away from the origin, single positions keep fewer digits than noise has: the mean of the vertices that faces use
    is taken away. Vertices without faces, which may be anywhere, wait at the origin. Spikes are taken off, for one that
    is far enough would move the mean, and with it all digits. Meshes so small or so large that powers of their lengths
    would be no numbers are scaled by a power of two, which takes no digit.

    Args:
        topology: Adjacency of the mesh.
        vertices: Positions (V, 3), mesh units, finite.
        takes_spikes_off: Whether spikes are, and meshes of unusual size scaled; a filter sees spikes as any other
            noise, and has parameters in mesh units.
        spikes: Of this mesh, where they are known.

    Attributes:
        positions: (V, 3), about the origin, in mesh units times a power of two.
        spikes: That were taken off; None where they were not looked for.

    Choice: docs/choices.md#spikes, docs/choices.md#origin.
    """

    def __init__(
        self,
        topology: _geom.Topology,
        vertices: NDArray[np.float64],
        *,
        takes_spikes_off: bool = True,
        spikes: Spikes | None = None,
    ) -> None:
        self._given = vertices
        self.spikes = (spikes or Spikes(topology, vertices)) if takes_spikes_off else None
        lowered = vertices if self.spikes is None else self.spikes.taken_off(vertices)
        is_used = np.diff(topology.vertex_faces()[0]) > 0
        self._origin = lowered[is_used].mean(axis=0) if is_used.any() else np.zeros(3)
        self.positions: NDArray[np.float64] = lowered - self._origin
        self.positions[~is_used] = 0.0
        self._doublings = _doublings(self.positions) if takes_spikes_off else 0
        if self._doublings:
            self.positions = np.ldexp(self.positions, self._doublings)

    def way_back(self, moved: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns moved positions (V, 3) where the mesh is; what did not move keeps the bits that it was given with."""
        back = (np.ldexp(moved, -self._doublings) if self._doublings else moved) + self._origin
        if self.spikes is not None:
            back = self.spikes.tips_put_back(back)
        stayed = (moved == self.positions).all(axis=1)
        return np.where(stayed[:, None], self._given, back)


def near_1(vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> tuple[NDArray[np.float64], int]:
    """Scales a mesh of unusual size by a power of two, so that products of its lengths are numbers.

    Args:
        vertices: (V, 3), mesh units, finite.
        faces: (F, 3), vertex ids.

    Returns:
        The positions doubled so often that the largest is near 1, those that no face uses at the origin; and how often,
        below 0 where they were halved: ``np.ldexp(positions, -count)`` takes them back. A mesh of usual size is
        returned as it is, with 0.

    Example:
        >>> positions, count = near_1(np.ldexp(np.eye(3), -300), np.array([[0, 1, 2]]))
        >>> positions[0].tolist(), count
        ([0.5, 0.0, 0.0], 299)
    """
    is_used = np.zeros(len(vertices), dtype=np.bool_)
    is_used[faces.reshape(-1)] = True
    used = np.where(is_used[:, None], vertices, 0.0)
    count = _doublings(used)
    return (np.ldexp(used, count) if count else vertices), count


def mean_edge_length(vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> float:
    """Returns the mean length of a mesh's edges, each counted once, whatever the size of the mesh.

    Args:
        vertices: (V, 3), mesh units, finite.
        faces: (F, 3), vertex ids.

    Returns:
        Mesh units; 0 for a mesh without an edge.

    Example:
        >>> mean_edge_length(np.array([[0.0, 0, 0], [3e-200, 0, 0], [0, 4e-200, 0]]), np.array([[0, 1, 2]], np.uint32))
        4e-200
    """
    positions, doublings = near_1(vertices, faces)
    return float(np.ldexp(_geom.mean_edge_length(positions, faces), -doublings))


def lengths(ways: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the lengths (V,) of ways (V, 3), also where their squares would be no numbers, or 0.

    Example:
        >>> lengths(np.array([[3e-200, 4e-200, 0.0]])).tolist()
        [5e-200]
    """
    found: NDArray[np.float64] = np.hypot(np.hypot(ways[:, 0], ways[:, 1]), ways[:, 2])
    return found


def _doublings(positions: NDArray[np.float64]) -> int:
    """How often an unusually small mesh must be doubled to be about as large as 1; below 0, halved."""
    extent = float(np.abs(positions).max(initial=0.0))
    is_usual = extent == 0.0 or USUAL[0] <= extent <= USUAL[1]
    return 0 if is_usual else -int(np.frexp(extent)[1])
