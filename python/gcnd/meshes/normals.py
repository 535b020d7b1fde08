"""Normals that a mesh or a file holds, made anew where vertices have moved."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.formats.polygons import Polygons
from gcnd.start import near_1

__all__ = ["Motion", "renewed_columns"]

Points = NDArray[np.float64]

_WHOLE_NAMES = ("Normals", "normals", "vertex_normals")
_AXIS_NAMES = ("nx", "ny", "nz")


class Motion:
    """Holds where vertices were and where they are, for making normals anew.

    n = Σ A_f n_f / |Σ A_f n_f|, over the faces f at a vertex, with areas A_f. Normals change only at faces with a
    corner that moved; all others keep their bits.

    Args:
        before: Positions (V, 3).
        after: Positions (V, 3).
        faces: Vertex ids (F, 3), anticlockwise seen from where normals point.
        polygons: Which faces the triangles stand for, where some have more corners; F is then that of the triangles.

    Example:
        >>> before = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> motion = Motion(before, before[:, [2, 0, 1]], np.array([[0, 1, 2]]))
        >>> motion.vertex_normals(np.tile([0.0, 0.0, 1.0], (3, 1))).tolist()
        [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """

    def __init__(
        self,
        before: NDArray[Any],
        after: NDArray[Any],
        faces: NDArray[Any],
        polygons: Polygons | None = None,
    ) -> None:
        self.polygons = polygons
        self.before = np.asarray(before, dtype=np.float64)
        self.faces = np.asarray(faces, dtype=np.int64)
        self.after = np.asarray(after, dtype=np.float64)
        self.has_moved = (self.before != self.after).any(axis=1)[self.faces].any(axis=1)
        near, _ = near_1(self.after, self.faces)
        a, b, c = (near[self.faces[:, corner]] for corner in range(3))
        self.face_sums: Points = np.cross(b - a, c - a)

    def face_normals(self, old: NDArray[Any]) -> NDArray[Any]:
        """Returns the normals of the faces, or of the polygons if there are any, (N, 3) in the type of the old ones."""
        owner = np.arange(len(self.faces)) if self.polygons is None else self.polygons.owner
        return self._renewed(old, owner[:, None], np.arange(len(old)))

    def by_triangle(self, values: NDArray[Any]) -> NDArray[Any]:
        """Returns what each triangle's corners have (F, 3) of values by corner of the faces (C,)."""
        return values.reshape(-1, 3) if self.polygons is None else values[self.polygons.corners]

    def vertex_normals(self, old: NDArray[Any]) -> NDArray[Any]:
        """Returns the normals of the vertices (V, 3) in the type of the old ones.

        Vertices that shared their position and their normal share the new one: a texture seam stays smooth, and a sharp
        edge stays sharp.
        """
        rows = np.column_stack([self.before, old]) + 0.0
        _, group = np.unique(rows, axis=0, return_inverse=True)
        group = group.reshape(-1)
        return self._renewed(old, group[self.faces], group)

    def shared_normals(self, old: NDArray[Any], corner_normal: NDArray[Any]) -> NDArray[Any]:
        """Returns normals (N, 3) that face corners refer to by number (F, 3), −1 for none."""
        return self._renewed(old, corner_normal, np.arange(len(old)))

    def _renewed(self, old: NDArray[Any], users: NDArray[Any], group: NDArray[Any]) -> NDArray[Any]:
        """Sums the faces by the groups of their corners (F, k), and gives each row of ``old`` its group's normal."""
        n_groups = int(max(group.max(initial=-1), users.max(initial=-1))) + 1
        sums, is_touched = np.zeros((n_groups, 3)), np.zeros(n_groups, dtype=bool)
        for column in users.T:
            used = column >= 0
            np.add.at(sums, column[used], self.face_sums[used])
            is_touched[column[used & self.has_moved]] = True
        lengths = np.linalg.norm(sums, axis=1)
        is_new = is_touched & (lengths > 0.0)
        new = old.copy()
        rows = is_new[group]
        new[rows] = (sums / np.where(lengths > 0.0, lengths, 1.0)[:, None])[group][rows].astype(old.dtype)
        return new


def renewed_columns(values: dict[str, NDArray[Any]], motion: Motion) -> dict[str, NDArray[Any]]:
    """Makes anew the vertex normals among named values per vertex.

    Args:
        values: Arrays (V,) or (V, n) by name; "Normals", "normals" and "vertex_normals" are normals if of shape (V, 3),
            "nx", "ny" and "nz" together.
        motion: How the vertices moved.

    Returns:
        Only what is new, by name.
    """
    n_vertices = len(motion.before)
    new = {
        name: motion.vertex_normals(values[name])
        for name in _WHOLE_NAMES
        if name in values and values[name].shape == (n_vertices, 3) and values[name].dtype.kind == "f"
    }
    axes = [values[name] for name in _AXIS_NAMES if name in values]
    if len(axes) == 3 and all(axis.shape == (n_vertices,) and axis.dtype.kind == "f" for axis in axes):
        normals = motion.vertex_normals(np.column_stack(axes))
        for index, name in enumerate(_AXIS_NAMES):
            new[name] = normals[:, index].astype(axes[index].dtype)
    return new
