"""Spikes: single vertices far off the surface are taken off for the work, so that those around do not suffer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gcnd import _geom

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["Spikes"]


class Spikes:
    """Which vertices of a mesh are spikes, and what becomes of them.

    Those inside the surface are noise, and stay on the surface. Those on a boundary, the tips of triangles that hang
    on a rim, come back: on the surface their triangles would have no area.

    Args:
        topology: Adjacency of the mesh.
        vertices: Positions (V, 3), mesh units.

    Attributes:
        n_inside: How many are inside the surface.
        n_on_rim: How many are tips of triangles that hang on a rim.

    Choice: docs/choices.md#spikes.
    """

    def __init__(self, topology: _geom.Topology, vertices: NDArray[np.float64]) -> None:
        self.ids, self._feet, is_on_rim = _geom.find_spikes(topology, vertices)
        self._tips, self._tip_feet = self.ids[is_on_rim], self._feet[is_on_rim]
        self._tip_positions = vertices[self._tips]
        self.n_on_rim = len(self._tips)
        self.n_inside = len(self.ids) - self.n_on_rim

    def taken_off(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns positions (V, 3) with every spike on the surface; the same array where there is none."""
        if not len(self.ids):
            return vertices
        lowered = vertices.copy()
        lowered[self.ids] = self._feet
        return lowered

    def tips_put_back(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns positions (V, 3) with the tips on a boundary as far from the surface as they were."""
        if not len(self._tips):
            return vertices
        raised = vertices.copy()
        raised[self._tips] = self._tip_positions + (vertices[self._tips] - self._tip_feet)
        return raised

    def told(self) -> tuple[str, ...]:
        """Returns a sentence for whoever owns the mesh; none where there is no spike."""
        if not len(self.ids):
            return ()
        fates = [
            f"{count:,} {fate}"
            for count, fate in (
                (self.n_inside, "inside the surface, put on it"),
                (self.n_on_rim, "at tips of triangles on a rim, taken off for the work and put back"),
            )
            if count
        ]
        return (f"spikes, single vertices far off the surface: {'; '.join(fates)}",)
