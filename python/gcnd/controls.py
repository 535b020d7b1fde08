"""What people want to say about a result: how strong, how far, where not, and how much volume."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gcnd.errors import ConfigError, MeshError
from gcnd.mesh_io import MeshArrays
from gcnd.meshes.arrays import LARGEST_COORDINATE
from gcnd.repeats import without_repeats
from gcnd.start import lengths, mean_edge_length
from gcnd.volume import check_closed, restored_volume, tell_nobody

__all__ = ["Controls"]

Points = NDArray[np.float64]

_ATTRIBUTE_HOLDERS = ("vertex_attributes", "point_data", "vertex")
"""Where trimesh, then pyvista and meshio, then open3d keep values by vertex."""

_SHRINKING = (0.0, *(2.0**-k for k in range(52, -1, -4)))
"""Shares taken off a shortened displacement until rounding no longer makes it too long; the last leaves nothing."""


@dataclass(frozen=True, eq=False)
class Controls:
    """Says how much of a result is wanted, and where; of any method, after it has run.

    v' = limit(v + strength (v̂ − v)) for a vertex v that the method moves to v̂, then v' = limit(v' + t n) with one t for
    each closed body where the volume is to stay.

    Attributes:
        strength: 0 keeps the input bit for bit, 1 is the full result; the way of every vertex grows with it.
        max_displacement: No vertex moves further, in mesh units; never exceeded, also after rounding to the input's
            32 or 16 bits.
        max_displacement_edges: The same in mean edge lengths of the input; with both, the smaller counts.
        keep: Vertices that are left untouched bit for bit: booleans (V,), or the name of a vertex attribute of the
            mesh, which keeps where it is not 0. Vertices at the position of a kept one stay too.
        preserve_volume: Whether every closed body ends with the volume it had; ``max_displacement`` and ``keep`` go
            first. Meshes that are not closed are refused.

    Raises:
        ConfigError: A value is out of range.

    Choice: docs/choices.md#strength, docs/choices.md#volume.

    Example:
        >>> Controls(strength=0.5, max_displacement_edges=0.3).preserve_volume
        False
    """

    strength: float = 1.0
    max_displacement: float | None = None
    max_displacement_edges: float | None = None
    keep: ArrayLike | str | None = None
    preserve_volume: bool = False

    def __post_init__(self) -> None:
        _check_number("strength", self.strength, 1.0)
        for name in ("max_displacement", "max_displacement_edges"):
            if getattr(self, name) is not None:
                _check_number(name, getattr(self, name), math.inf)
        if not isinstance(self.preserve_volume, bool | np.bool_):
            raise ConfigError(f"preserve_volume is {self.preserve_volume!r}, allowed: True or False")
        for name in ("strength", "max_displacement", "max_displacement_edges", "preserve_volume"):
            value = getattr(self, name)
            if value is not None:
                # Of Python's own types, as a report needs them; a number of numpy's 32 bits would make others of 32.
                object.__setattr__(self, name, bool(value) if name == "preserve_volume" else float(value))

    def bind(
        self, mesh: Any, arrays: MeshArrays, ask: Callable[[], object] = tell_nobody
    ) -> tuple[MeshArrays, Callable[[Points], Points]]:
        """Checks the controls against a mesh, before any long work.

        Args:
            mesh: As it was given, for its attributes.
            arrays: Its vertices (V, 3) and faces.
            ask: Called between the steps of the function that is returned; what it raises stops that.

        Returns:
            The mesh with each position once, (V', 3), and a function from positions (V', 3) that a method found to
            the wanted ones (V, 3).

        Raises:
            ConfigError: ``keep`` does not fit the mesh.
            MeshError: The volume is to stay and there is none.
        """
        welded, ids = arrays.welded()
        kept = np.zeros(len(welded.vertices), dtype=bool)
        if self.keep is not None:
            kept[ids[self._mask(mesh, len(arrays.vertices))]] = True
        closed = welded
        if self.preserve_volume:
            closed, _ = without_repeats(welded)
            check_closed(closed.faces)
        longest = self._longest(welded)

        def finish(moved: Points) -> Points:
            return _like_before(arrays, welded, ids, self._steered(closed, moved, kept, longest, ask))

        return welded, finish

    def described(self) -> dict[str, Any]:
        """Returns the controls as JSON-ready values; of a mask, how many vertices it keeps."""
        keep = self.keep
        if keep is not None and not isinstance(keep, str):
            keep = f"{np.count_nonzero(_as_array(keep))} vertices"
        return {
            "strength": self.strength,
            "max_displacement": self.max_displacement,
            "max_displacement_edges": self.max_displacement_edges,
            "keep": keep,
            "preserve_volume": self.preserve_volume,
        }

    def _steered(
        self,
        mesh: MeshArrays,
        moved: Points,
        kept: NDArray[np.bool_],
        longest: float | None,
        ask: Callable[[], object],
    ) -> Points:
        before = mesh.vertices

        def limited(vertices: Points) -> Points:
            return vertices if longest is None else _limited(before, vertices, longest, ask)

        result = limited(np.where(kept[:, None], before, _blended(before, moved, self.strength)))
        if self.preserve_volume:
            result = restored_volume(result, mesh.faces, before, ~kept, limited, ask)
        return result

    def _longest(self, mesh: MeshArrays) -> float | None:
        limits = [] if self.max_displacement is None else [self.max_displacement]
        if self.max_displacement_edges is not None:
            limits.append(self.max_displacement_edges * mean_edge_length(mesh.vertices, mesh.faces))
        return min(limits, default=None)

    def _mask(self, mesh: Any, n_vertices: int) -> NDArray[np.bool_]:
        if isinstance(self.keep, str):
            return _from_attribute(mesh, self.keep, n_vertices)
        mask = _as_array(self.keep)
        if mask.dtype != bool:
            raise ConfigError(f"keep is of type {mask.dtype}, allowed: booleans, one a vertex")
        if mask.shape != (n_vertices,):
            raise ConfigError(f"keep has shape {mask.shape}, and the mesh has {n_vertices} vertices")
        return mask


def _check_number(name: str, value: Any, largest: float) -> None:
    allowed = "0 or more, and finite" if math.isinf(largest) else f"0 to {largest:g}"
    try:
        is_right = not isinstance(value, bool) and 0.0 <= float(value) <= largest and math.isfinite(value)
    except (TypeError, ValueError):
        is_right = False
    if not is_right:
        raise ConfigError(f"{name} is {value!r}, allowed: {allowed}")


def _as_array(values: Any) -> NDArray[Any]:
    return np.asarray(values.detach().cpu() if hasattr(values, "detach") else values)


def _from_attribute(mesh: Any, name: str, n_vertices: int) -> NDArray[np.bool_]:
    attributes: dict[str, Any] = {}
    holders: list[Any] = [getattr(mesh, name, None) for name in _ATTRIBUTE_HOLDERS]
    for holder in holders:
        # Of their type: an object of open3d takes any name for a key of its own.
        if hasattr(type(holder), "__iter__") and hasattr(type(holder), "__getitem__"):
            attributes.update({str(key): holder[key] for key in holder})
    if name not in attributes:
        known = ", ".join(sorted(attributes)) or "none"
        raise ConfigError(f"the mesh has no vertex attribute {name!r}", f"its vertex attributes: {known}")
    values = attributes[name]
    array = np.asarray(values.numpy() if hasattr(values, "numpy") else values)
    if array.size != n_vertices or len(array) != n_vertices or array.dtype.kind not in "biuf":
        raise ConfigError(
            f"vertex attribute {name!r} has shape {array.shape} and type {array.dtype}, not one number a vertex"
        )
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ConfigError(f"vertex attribute {name!r} has values that are not finite")
    is_kept: NDArray[np.bool_] = array.reshape(-1) != 0
    return is_kept


def _blended(before: Points, moved: Points, strength: float) -> Points:
    """Both ends exact, and no rounding leads past them."""
    if strength in (0.0, 1.0):
        return moved if strength else before
    low, high = np.minimum(before, moved), np.maximum(before, moved)
    return np.clip(before + strength * (moved - before), low, high)


def _limited(before: Points, moved: Points, longest: float, ask: Callable[[], object]) -> Points:
    """Displacements shortened to ``longest`` where they are longer, in 64 bits and in what the input fits in."""
    # A little less, so that no other way of taking the norm rounds to more.
    longest *= 1.0 - 2.0**-49
    result = moved.copy()
    far = np.arange(len(before))
    for share in _SHRINKING:
        ask()
        far = far[_is_too_far(before[far], result[far], longest)]
        if not len(far):
            break
        way = moved[far] - before[far]
        length = lengths(way)[:, None]
        result[far] = before[far] + way * (np.minimum(longest / length, 1.0) * (1.0 - share))
    return result


def _is_too_far(before: Points, moved: Points, longest: float) -> NDArray[np.bool_]:
    """Whether each displacement is too long (V,), as it is or once rounded to a type that holds the input exactly."""
    is_too_far = lengths(moved - before) > longest
    for dtype in (np.float32, np.float16):
        with np.errstate(over="ignore", invalid="ignore"):
            fits = (before.astype(dtype) == before).all(axis=1)
            rounded = lengths(moved.astype(dtype).astype(np.float64) - before)
        is_too_far |= fits & (rounded > longest)
    return is_too_far


def _like_before(arrays: MeshArrays, welded: MeshArrays, ids: NDArray[np.uint32], moved: Points) -> Points:
    """The mesh's own vertices (V, 3) where nothing moved, with the sign of every zero, and the moved ones elsewhere."""
    # What is written is to be read again.
    if not (np.abs(moved) <= LARGEST_COORDINATE).all():
        raise MeshError("positions left the range of numbers", "scale the mesh to a size near 1")
    has_moved = (moved != welded.vertices).any(axis=1)[ids]
    result = arrays.vertices.copy()
    result[has_moved] = moved[ids[has_moved]]
    return result
