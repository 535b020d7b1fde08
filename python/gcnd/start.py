"""Where the work on a mesh starts: around the origin, without what lies far off the surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gcnd.spikes import Spikes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from gcnd import _geom

__all__ = ["Start"]


class Start:
    """Positions to work from, and the way back to those of the mesh.

    Far away from the origin, single positions keep fewer digits than noise has: the mean of the vertices that faces use
    is taken away. Vertices without faces, which may be anywhere, wait at the origin. Spikes are taken off, for one that
    is far enough would move the mean, and with it all digits.

    Args:
        topology: Adjacency of the mesh.
        vertices: Positions (V, 3), mesh units, finite.
        takes_spikes_off: Whether spikes are; a filter sees them as any other noise.

    Attributes:
        positions: (V, 3), mesh units, about the origin.

    Choice: docs/choices.md#spikes.
    """

    def __init__(
        self, topology: _geom.Topology, vertices: NDArray[np.float64], *, takes_spikes_off: bool = True
    ) -> None:
        self._given = vertices
        self._spikes = Spikes(topology, vertices) if takes_spikes_off else None
        lowered = vertices if self._spikes is None else self._spikes.taken_off(vertices)
        is_used = np.diff(topology.vertex_faces()[0]) > 0
        self._origin = lowered[is_used].mean(axis=0) if is_used.any() else np.zeros(3)
        self.positions: NDArray[np.float64] = lowered - self._origin
        self.positions[~is_used] = 0.0

    def way_back(self, moved: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns moved positions (V, 3) where the mesh is; what did not move keeps the bits that it was given with."""
        back = moved + self._origin
        if self._spikes is not None:
            back = self._spikes.tips_put_back(back)
        stayed = (moved == self.positions).all(axis=1)
        return np.where(stayed[:, None], self._given, back)
