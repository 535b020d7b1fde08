"""Positions and triangles as arrays: checked, blended, and written for the `gcnd` command. Needs no Blender."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import Failure

__all__ = ["Triangles", "blended", "check", "moved_text", "read_positions", "write_ply"]

Positions = NDArray[np.float32]

_HEADER = """ply
format binary_little_endian 1.0
element vertex {n_vertices}
property float x
property float y
property float z
element face {n_faces}
property list uchar int vertex_indices
end_header
"""
_FACE = np.dtype([("n_corners", "u1"), ("corners", "<i4", (3,))])


class Triangles(NamedTuple):
    """A triangle mesh: positions (V, 3) in 32 bits, and vertex ids (F, 3)."""

    positions: Positions
    faces: NDArray[np.int32]


def check(mesh: Triangles) -> None:
    """Checks that there is something to denoise.

    Raises:
        Failure: There are no faces, or a position is not finite.
    """
    if not len(mesh.positions):
        raise Failure("The mesh is empty")
    if not len(mesh.faces):
        raise Failure(
            "The mesh has no faces", "denoising works on surfaces; loose vertices and edges have none"
        )
    broken = np.flatnonzero(~np.isfinite(mesh.positions).all(axis=1))
    if len(broken):
        raise Failure(
            f"{len(broken):,} vertices have positions that are not finite, the first is vertex {broken[0]}",
            "delete or move them in Edit Mode",
        )


def blended(
    before: Positions, after: Positions, strength: float, keep: NDArray[np.bool_] | None = None
) -> Positions:
    """Moves every vertex a share of its way.

    v' = v + strength (v̂ − v), as `gcnd denoise --strength` has it, so that the strength can change without a new run.

    Args:
        before: Positions (V, 3).
        after: The full result (V, 3).
        strength: 0 gives ``before`` bit for bit, 1 gives ``after``.
        keep: Vertices that stay where they are (V,); those at the same position stay too, as with `--keep`.

    Returns:
        Positions (V, 3).
    """
    low, high = np.minimum(before, after), np.maximum(before, after)
    way = after.astype(np.float64) - before
    part = np.clip((before + strength * way).astype(np.float32), low, high)
    result = after.copy() if strength == 1.0 else part
    # Also where nothing moves, so that a zero keeps its sign.
    stays = (before == after).all(axis=1) | (strength == 0.0)
    if keep is not None and keep.any():
        ids = np.unique(before, axis=0, return_inverse=True)[1].reshape(-1)
        is_kept = np.zeros(len(before), dtype=bool)
        is_kept[ids[keep]] = True
        stays |= is_kept[ids]
    result[stays] = before[stays]
    return result


def moved_text(before: Positions, after: Positions) -> str:
    """Says in words how many vertices moved, and how far."""
    lengths = np.linalg.norm(after.astype(np.float64) - before, axis=1)
    return f"{np.count_nonzero(lengths):,} of {len(lengths):,} vertices moved, {lengths.max():.3g} at most"


def write_ply(path: Path, mesh: Triangles) -> None:
    """Writes a mesh as the binary PLY file that `read_positions` expects back."""
    header = _HEADER.format(n_vertices=len(mesh.positions), n_faces=len(mesh.faces))
    faces = np.empty(len(mesh.faces), dtype=_FACE)
    faces["n_corners"], faces["corners"] = 3, mesh.faces
    path.write_bytes(header.encode() + mesh.positions.astype("<f4").tobytes() + faces.tobytes())


def read_positions(path: Path, source: Path) -> Positions:
    """Reads the positions of a result: `gcnd` changes nothing else of a file that it writes in its input's format.

    Args:
        path: What the command wrote.
        source: What `write_ply` wrote for it.

    Returns:
        Positions (V, 3).

    Raises:
        Failure: It is not the source with other positions.
    """
    before, after = source.read_bytes(), path.read_bytes()
    start = before.index(b"end_header\n") + len(b"end_header\n")
    n_vertices = int(before[:start].split(b"element vertex ")[1].split()[0])
    end = start + 12 * n_vertices
    if len(after) != len(before) or after[:start] != before[:start] or after[end:] != before[end:]:
        raise Failure(
            "The command wrote another mesh than it was given", "set the path of gcnd in the preferences"
        )
    positions = np.frombuffer(after, dtype="<f4", count=3 * n_vertices, offset=start)
    return positions.reshape(-1, 3).astype(np.float32)
