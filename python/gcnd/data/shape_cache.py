"""Procedural shapes on disk, so that a training run makes each one once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from gcnd.data.shapes import SHAPE_KINDS, Shape, ShapeKind, make_shape
from gcnd.errors import ConfigError
from gcnd.formats.atomic import read_npz, write_atomic_npz

SHAPES_VERSION = 4
"""Raise when `make_shape` changes what a seed gives: older files are then ignored."""

DEFAULT_KINDS: Mapping[ShapeKind, float] = {"cad": 0.35, "smooth": 0.3, "feature": 0.35}
"""The shares of the kinds that `load_shapes` makes unless told otherwise."""


def shape_path(directory: Path | str, seed: int, kind: ShapeKind) -> Path:
    """Return where the shape of a seed is kept.

    Example:
        >>> shape_path("shapes", 7, "cad").name
        'shape-v4-cad-00000007.npz'
    """
    return Path(directory) / f"shape-v{SHAPES_VERSION}-{kind}-{seed:08d}.npz"


def load_shapes(
    n: int,
    seed: int,
    directory: Path | str,
    *,
    workers: int = 2,
    kinds: Mapping[ShapeKind, float] = DEFAULT_KINDS,
    progress: Callable[[int, int], None] | None = None,
) -> list[Shape]:
    """Return `n` procedural shapes, from disk where they are and made and stored where they are not.

    Shape i has seed ``seed + i``. Its kind follows the shares: every stretch of the list holds each kind about in
    proportion, so a longer list begins with the shorter one.

    Args:
        n: How many shapes, >= 0.
        seed: Seed of the first shape, >= 0.
        directory: Where the ``.npz`` files lie; made if missing.
        workers: Processes that make what is missing; 1 works in this process.
        kinds: Share of each kind, any positive scale; kinds left out are not made.
        progress: Called with the shapes made and those to make after each.

    Returns:
        The shapes in seed order.

    Raises:
        ConfigError: A negative count or seed, fewer than one worker, or shares that are unknown, negative or all 0.

    Choice: docs/choices.md#training-shapes.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     shapes = load_shapes(1, 0, folder, workers=1, kinds={"smooth": 1.0})
        >>> shapes[0].kind
        'smooth'
    """
    if n < 0 or seed < 0 or workers < 1:
        message = f"cannot load {n} shapes from seed {seed} with {workers} workers"
        raise ConfigError(message, hint="n and seed must be >= 0 and workers >= 1")
    wanted = list(zip(range(seed, seed + n), kind_sequence(n, kinds), strict=True))
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    missing = [job for job in wanted if not shape_path(folder, *job).exists()]
    for made, _ in enumerate(_make_all(missing, folder, workers), start=1):
        if progress is not None:
            progress(made, len(missing))
    return [_read(shape_path(folder, *job)) or _make(folder, *job) for job in wanted]


def kind_sequence(n: int, kinds: Mapping[ShapeKind, float]) -> list[ShapeKind]:
    """Return the kinds of `n` shapes, each next the one furthest behind its share.

    Raises:
        ConfigError: Shares that are unknown, negative, or all 0.

    Example:
        >>> kind_sequence(4, {"cad": 0.5, "smooth": 0.25, "feature": 0.25})
        ['cad', 'smooth', 'feature', 'cad']
    """
    unknown = [kind for kind in kinds if kind not in SHAPE_KINDS]
    total = sum(kinds.values())
    if unknown or not total > 0 or min(kinds.values()) < 0:
        raise ConfigError(
            f"shares of shape kinds are {dict(kinds)}",
            hint=f"give {', '.join(SHAPE_KINDS)} shares >= 0, not all 0",
        )
    made = dict.fromkeys(kinds, 0)
    sequence: list[ShapeKind] = []
    for i in range(n):
        kind = max(kinds, key=lambda k: kinds[k] / total * (i + 1) - made[k])
        made[kind] += 1
        sequence.append(kind)
    return sequence


def _make_all(jobs: Sequence[tuple[int, ShapeKind]], folder: Path, workers: int) -> Iterator[None]:
    """Makes what is missing, one file at every step of the iteration."""
    if workers == 1 or len(jobs) < 2:
        for seed, kind in jobs:
            _make(folder, seed, kind)
            yield
        return
    # A fork would copy locks held by threads of the parent, such as torch's.
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(_make_file, folder, seed, kind) for seed, kind in jobs]
        for future in futures:
            yield future.result()


def _make_file(folder: Path, seed: int, kind: ShapeKind) -> None:
    _make(folder, seed, kind)


def _make(folder: Path, seed: int, kind: ShapeKind) -> Shape:
    shape = make_shape(seed, kind)
    write_atomic_npz(shape_path(folder, seed, kind), **vars(shape))
    return shape


def _read(path: Path) -> Shape | None:
    """Return the shape in a file, or None if the file is damaged."""
    data = read_npz(path, "kind", "name", "vertices", "faces")
    kind = None if data is None else next((k for k in SHAPE_KINDS if k == str(data["kind"])), None)
    if data is None or kind is None:
        return None
    return Shape(str(data["name"]), kind, data["vertices"], data["faces"])
