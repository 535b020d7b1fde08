"""Generated shapes for who may not have what generates them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from gcnd.errors import GcndError

if TYPE_CHECKING:
    from gcnd.data.shapes import Shape, ShapeKind


def load_generated(
    n: int,
    seed: int,
    folder: Path,
    *,
    hint: str,
    kinds: Mapping[ShapeKind, float] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Shape]:
    """Load ``n`` generated shapes from ``seed`` on, made and kept in ``folder`` where missing.

    Args:
        n: How many, >= 0.
        seed: Of the first.
        folder: Keeps them.
        hint: What to do where they cannot be generated.
        kinds: Share of each kind, or None for those of `load_shapes`.
        progress: Called with the shapes made and those to make after each.

    Raises:
        GcndError: What generates shapes is not installed.

    Example:
        >>> load_generated(1, 0, Path("shapes"), hint="pip install 'gcnd[train]'")[0].kind  # doctest: +SKIP
        'cad'
    """
    # Only who generates shapes needs what generates them.
    try:
        from gcnd.data.shape_cache import DEFAULT_KINDS, load_shapes
    except ImportError as error:
        raise GcndError(f"procedural shapes need {error.name}", hint=hint) from error
    return load_shapes(n, seed, folder, kinds=kinds or DEFAULT_KINDS, progress=progress)
