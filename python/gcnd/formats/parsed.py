"""What a mesh file holds, as plain arrays, and the steps that the formats share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.polygons import Polygons, split_polygons

__all__ = [
    "ParsedMesh",
    "check_ids",
    "polygon_error",
    "rgba_from_values",
    "split_seams",
    "triangles_of",
    "truncated_error",
]

TRIANGULATE_HINT = (
    "gcnd denoise --triangulate and gcnd noise --triangulate (triangulate=True in Python) split such faces for "
    "the work and write them whole; "
    "or triangulate the mesh first (Blender: Ctrl+T in edit mode; MeshLab: Turn into a Pure-Triangular Mesh)"
)
DAMAGED_HINT = "the file is cut off or damaged; write or download it again"


@dataclass
class ParsedMesh:
    """Holds one triangle mesh as read from a file, before it becomes any library's object.

    Attributes:
        vertices: float64 (V, 3), file units, in the file's order.
        faces: int64 (F, 3), indices into `vertices`, in the file's order.
        vertex_colors: uint8 (V, 4) RGBA, or None.
        face_colors: uint8 (F, 4) RGBA, or None.
        uv: float64 (V, 2) texture coordinates, or None.
        vertex_attributes: Any other value per vertex, each (V,) or (V, n).
        face_attributes: Any other value per face, each (F,) or (F, n).
        metadata: What the file says about the whole mesh.
        texture: Name of the texture image, as the file writes it, or None.
        material_libraries: Names of material files, as the file writes them, several in a line too.
        material: Name of the one material in use, or None.
        source_vertex: int64 (V,), the file's vertex of each vertex here, where seams repeat some; or None.
        polygons: Which faces of the file the triangles stand for, where some have more corners; or None.
        oddity: What is wrong with the file and does no harm, in a few words; or None.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    vertex_colors: NDArray[np.uint8] | None = None
    face_colors: NDArray[np.uint8] | None = None
    uv: NDArray[np.float64] | None = None
    vertex_attributes: dict[str, NDArray[Any]] = field(default_factory=dict)
    face_attributes: dict[str, NDArray[Any]] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)
    texture: str | None = None
    material_libraries: list[str] = field(default_factory=list)
    material: str | None = None
    source_vertex: NDArray[np.int64] | None = None
    polygons: Polygons | None = None
    oddity: str | None = None

    def repeat_vertices(self, source_vertex: NDArray[np.int64]) -> None:
        """Replaces the vertices, and every value per vertex, by the rows `source_vertex` names.

        Args:
            source_vertex: int64 (V',), old vertex id of each new vertex.
        """
        self.source_vertex = source_vertex
        self.vertices = self.vertices[source_vertex]
        if self.vertex_colors is not None:
            self.vertex_colors = self.vertex_colors[source_vertex]
        self.vertex_attributes = {k: v[source_vertex] for k, v in self.vertex_attributes.items()}


def check_ids(ids: NDArray[np.int64], lengths: NDArray[np.int64], n_vertices: int) -> None:
    """Checks that the corners of faces (C,), with so many a face (F,), are vertices, in the words of `checked`.

    Raises:
        MeshError: The first one that is none, with its face.
    """
    outside = (ids < 0) | (ids >= n_vertices)
    if outside.any():
        corner = int(np.argmax(outside))
        face_id = int(np.searchsorted(np.cumsum(lengths), corner, side="right"))
        raise MeshError(
            f"face {face_id} refers to vertex {int(ids[corner])}, and the mesh has "
            f"{n_vertices} vertices (counted from 0)",
            DAMAGED_HINT,
        )


def triangles_of(
    vertices: NDArray[np.float64], ids: NDArray[np.int64], lengths: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Polygons | None]:
    """Finds the triangles of faces given corner by corner; arguments as of `split_polygons`.

    Returns:
        Of each triangle's corners, the place in ``ids`` (T, 3); and the polygons, None where all faces are triangles.
    """
    if (lengths == 3).all():
        return np.arange(len(ids)).reshape(-1, 3), None
    polygons = split_polygons(vertices, ids, lengths)
    return polygons.corners, polygons


def polygon_error(face_id: int, n_corners: int, where: str = "") -> MeshError:
    """Makes the error for a face that is not a triangle.

    Args:
        face_id: The first such face, counted from 0.
        n_corners: How many corners it has.
        where: Its place in the file, such as " (line 12)", or nothing.

    Returns:
        A MeshError that names the face, with a hint.
    """
    hint = TRIANGULATE_HINT if n_corners > 3 else DAMAGED_HINT
    return MeshError(f"face {face_id}{where} has {n_corners} corners, not 3", hint)


def truncated_error(what: str, expected: int, got: int) -> MeshError:
    """Makes the error for a file that holds less than it announces.

    Args:
        what: What was counted, in the plural: "faces", "bytes of data".
        expected: How many the file announces.
        got: How many it holds.

    Returns:
        A MeshError that names both counts, with a hint.
    """
    return MeshError(f"the file announces {expected} {what} and holds {got}", DAMAGED_HINT)


def rgba_from_values(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Converts colours to 8 bits per channel.

    Fractions in [0, 1] become round(255 x), 16-bit integers are scaled, other integers stay.

    Args:
        values: (n, 3) or (n, 4), red, green, blue and perhaps alpha.

    Returns:
        uint8 (n, 4) RGBA; alpha 255 where there was none.

    Example:
        >>> rgba_from_values(np.array([[1.0, 0.0, 0.2]])).tolist()
        [[255, 0, 51, 255]]
    """
    channels = np.asarray(values)
    if channels.dtype.kind == "f" and channels.size and np.nanmax(channels) <= 1.0:
        channels = np.round(np.nan_to_num(channels) * 255.0)
    elif channels.dtype == np.uint16:
        channels = channels // 257
    rgba = np.full((len(channels), 4), 255, dtype=np.uint8)
    rgba[:, : channels.shape[1]] = np.clip(np.nan_to_num(channels), 0, 255).astype(np.uint8)
    return rgba


def split_seams(
    faces: NDArray[np.int64], corner_values: NDArray[np.int64], n_vertices: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Splits vertices whose face corners carry different values, such as texture coordinates at a seam.

    The first `n_vertices` vertices stay as they are, in their order; a vertex with k different values gets
    k − 1 copies, and all copies follow at the end. Corners without a value (−1) stay on the vertex itself.

    Args:
        faces: int64 (F, 3), vertex id of each corner.
        corner_values: int64 (F, 3), id of each corner's value, or −1.
        n_vertices: Number of vertices before splitting.

    Returns:
        The new faces (F, 3), the old vertex id of each new vertex (V',), and the value id of each new
        vertex (V',), −1 for a vertex that no corner gives a value.

    Example:
        >>> faces = np.array([[0, 1, 2], [0, 2, 3]])
        >>> new_faces, source, value = split_seams(faces, np.array([[0, 1, 2], [3, 2, 4]]), 4)
        >>> new_faces.tolist(), source.tolist(), value.tolist()
        ([[0, 1, 2], [4, 2, 3]], [0, 1, 2, 3, 0], [0, 1, 2, 4, 3])
    """
    width = int(corner_values.max(initial=-1)) + 2
    keys = faces.ravel() * width + (corner_values.ravel() + 1)
    unique, first_corner, inverse = np.unique(keys, return_index=True, return_inverse=True)
    vertex, value = unique // width, unique % width - 1
    # The vertex itself keeps the value that comes first in the file; corners without one share its place.
    order = np.lexsort((first_corner, value < 0, vertex))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = vertex[order][1:] != vertex[order][:-1]
    is_copy = np.zeros(len(unique), dtype=bool)
    is_copy[order] = ~is_first
    is_copy &= value >= 0
    copies = np.flatnonzero(is_copy)
    copies = copies[np.argsort(first_corner[copies])]
    new_id = vertex.copy()
    new_id[copies] = n_vertices + np.arange(len(copies))
    source_vertex = np.concatenate([np.arange(n_vertices), vertex[copies]])
    vertex_value = np.full(len(source_vertex), -1, dtype=np.int64)
    has_value = value >= 0
    vertex_value[new_id[has_value]] = value[has_value]
    return new_id[inverse.reshape(faces.shape)], source_vertex, vertex_value
