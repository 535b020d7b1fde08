"""How much memory there is and how much a mesh will take: out of memory is told before the work, not by the system."""

from __future__ import annotations

import math
from pathlib import Path

from gcnd.errors import MeshError

__all__ = ["available_bytes", "check_memory", "filter_bytes_a_face", "needed_bytes", "nodes_that_fit"]

BYTES_A_FACE = 700
"""A face of a mesh in work: 575 measured between 100,000 and 1,000,000 faces (docs/limits.md), and a fifth."""

BYTES_OF_FACTORS = {"l0": 140, "tgv": 350}
"""Filters that factorise systems: a face takes so many bytes times the binary logarithm of the number of faces, a fifth
and more above what was measured (docs/limits.md)."""

SHARE_OF_BATCHES = 0.25
"""Of the free memory, what the batches of all threads may take together; a mesh takes the rest."""

_MEMINFO, _CGROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")


def available_bytes() -> int | None:
    """Returns how much memory a process may still take, or None where the system does not say.

    On Linux what is free or can be freed, and no more than the control group leaves.
    """
    try:
        lines = dict(line.split(":", 1) for line in _MEMINFO.read_text(encoding="ascii").splitlines())
        free = int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return None
    try:
        limit = int((_CGROUP / "memory.max").read_text(encoding="ascii"))
        used = int((_CGROUP / "memory.current").read_text(encoding="ascii"))
    except (OSError, ValueError):  # another system, or a group without a limit, which says "max"
        return free
    return max(0, min(free, limit - used + _cached_bytes()))


def _cached_bytes() -> int:
    """What the control group counts as used and gives back when it is needed: files that were read a while ago."""
    path = _CGROUP / "memory.stat"
    lines = path.read_text(encoding="ascii").splitlines() if path.is_file() else []
    return next((int(line.split()[1]) for line in lines if line.startswith("inactive_file ")), 0)


def filter_bytes_a_face(method: str, n_faces: int, patch_size: int = 50) -> int:
    """Estimates what a filter takes for each face of a mesh.

    Args:
        method: Name of the filter.
        n_faces: F.
        patch_size: Of ``low-rank``, which keeps so many numbers of 4 bytes for each vertex, at 50 within the usual.

    Returns:
        Bytes; what the network takes for most of them.

    Example:
        >>> [filter_bytes_a_face(name, 1 << 20) for name in ("taubin", "l0", "tgv")]
        [700, 2800, 7000]
    """
    of_factors = BYTES_OF_FACTORS.get(method, 0) * math.log2(max(2, n_faces))
    of_patches = 2 * max(0, patch_size - 50) if method == "low-rank" else 0
    return max(BYTES_A_FACE + of_patches, math.ceil(of_factors))


def needed_bytes(n_vertices: int, n_faces: int, bytes_a_face: int = BYTES_A_FACE) -> int:
    """Estimates what denoising a mesh takes on top of the program itself.

    Args:
        n_vertices: V; a mesh has half as many as faces, and only what goes beyond that is counted apart.
        n_faces: F.
        bytes_a_face: Of the method.

    Returns:
        Bytes.

    Example:
        >>> needed_bytes(500_000, 1_000_000)
        700000000
    """
    return bytes_a_face * n_faces + 200 * max(0, n_vertices - n_faces // 2)


def check_memory(n_vertices: int, n_faces: int, bytes_a_face: int = BYTES_A_FACE) -> None:
    """Checks that there is memory for a mesh, before any long work.

    Args:
        n_vertices: V.
        n_faces: F.
        bytes_a_face: Of the method.

    Raises:
        MeshError: There is too little.
    """
    needed, free = needed_bytes(n_vertices, n_faces, bytes_a_face), available_bytes()
    if free is not None and needed > free:
        raise MeshError(
            f"{n_faces:,} faces need about {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free",
            "close other programs, cut the mesh into parts, or use a machine with more memory",
        )


def nodes_that_fit(wanted: int, fewest: int, bytes_a_node: int, n_threads: int) -> int:
    """Halves a batch until those of all threads fit into a fourth of the free memory.

    Args:
        wanted: Nodes that a thread takes through a network at once where there is room.
        fewest: Nodes of one patch, below which nothing is halved.
        bytes_a_node: That the network takes.
        n_threads: That each take a batch.

    Returns:
        Nodes a batch; ``wanted`` where the system does not say how much is free.

    Example:
        >>> nodes_that_fit(4096, 64, 5000, 1)
        4096
    """
    free = available_bytes()
    while (
        free is not None and wanted > fewest and wanted * bytes_a_node * n_threads > SHARE_OF_BATCHES * free
    ):
        wanted //= 2
    return max(wanted, fewest)
