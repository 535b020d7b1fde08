"""Synthetic noise on clean meshes, with the benchmark's definitions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy import sparse

from gcnd import start
from gcnd.errors import ConfigError, MeshError
from gcnd.forks import refuse_fork

FloatArray = npt.NDArray[np.float64]
FaceArray = npt.NDArray[np.uint32]
AnyFaces = npt.NDArray[np.integer]

NoiseKind = Literal["gaussian", "impulsive", "isotropic", "varying", "correlated"]
"""The kinds of noise that `add_noise` makes."""

NOISE_KINDS: tuple[NoiseKind, ...] = get_args(NoiseKind)

VARYING_RANGE = (0.3, 1.7)
"""Smallest and largest factor on the level of ``"varying"`` noise."""

_MAX_LEVEL = 1000.0
_VARYING_SMOOTHING = 60
_CORRELATED_SMOOTHING = (2, 8)


def mean_edge_length(vertices: FloatArray, faces: AnyFaces) -> float:
    """Return the mean length of a mesh's edges, each counted once, in mesh units.

    Args:
        vertices: (V, 3) float64, positions in mesh units.
        faces: (F, 3), vertex ids.

    Returns:
        The mean over unique edges; 0.0 for a mesh without one.

    Example:
        >>> import numpy as np
        >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        >>> float(round(mean_edge_length(square, np.array([[0, 1, 2], [0, 2, 3]])), 4))
        1.0828
    """
    return start.mean_edge_length(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.uint32)
    )


def vertex_normals(vertices: FloatArray, faces: AnyFaces) -> FloatArray:
    """Return the area-weighted unit normal of every vertex.

    n_v = s / |s|, s the sum over the faces at v of (p_1 - p_0) x (p_2 - p_0).

    Args:
        vertices: (V, 3) float64, positions in mesh units.
        faces: (F, 3), vertex ids.

    Returns:
        (V, 3) float64; zero where the sum is zero or the vertex has no face.

    Example:
        >>> import numpy as np
        >>> triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> vertex_normals(triangle, np.array([[0, 1, 2]]))[0].tolist()
        [0.0, 0.0, 1.0]
    """
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for slot in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, slot], weights=cross[:, axis], minlength=len(vertices))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    normals: FloatArray = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return normals


def add_noise(
    vertices: FloatArray,
    faces: FaceArray,
    *,
    kind: NoiseKind = "gaussian",
    level: float = 0.2,
    fraction: float = 0.3,
    seed: int = 0,
) -> FloatArray:
    """Return a clean mesh's vertices with synthetic noise of standard deviation ``level * e``.

    With e the mean edge length of the clean mesh, n_v the area-weighted normal of vertex v on the clean mesh and
    z_v independent N(0, 1):

    - ``gaussian``: v' = v + level e z_v n_v
    - ``impulsive``: as ``gaussian`` for ``round(fraction * V)`` vertices drawn without replacement; the rest stay
    - ``isotropic``: v' = v + level e (z_1, z_2, z_3), independent in the three coordinates
    - ``varying``: as ``gaussian`` with the level times a smooth random field between 0.3 and 1.7
    - ``correlated``: as ``gaussian`` with z smoothed over the vertex graph, then scaled back to variance 1

    Vertices at exactly the same position, as an STL file repeats them, move together and count once.

    Args:
        vertices: (V, 3) float64, clean positions in mesh units.
        faces: (F, 3), vertex ids.
        kind: One of `NOISE_KINDS`.
        level: Standard deviation in mean edge lengths, >= 0; for ``impulsive`` the strength.
        fraction: Share of vertices that ``impulsive`` moves, 0 to 1; not used otherwise.
        seed: Seed of the one random generator; the same seed gives the same noise.

    Returns:
        (V, 3) float64, a new array.

    Raises:
        ConfigError: An unknown kind, a level outside 0 to 1000, a fraction outside 0 to 1, or a negative seed.
        MeshError: A face has an id that is no vertex.

    Paper: Sec. 7.1, the synthetic noise. Choice: docs/choices.md#noise (direction along the clean normal, measured
    on the benchmark's files).

    Example:
        >>> import numpy as np
        >>> grid = np.array([[x, y, 0.0] for y in range(9) for x in range(9)])
        >>> quads = [(i, i + 1, i + 10, i + 9) for i in range(71) if i % 9 != 8]
        >>> faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
        >>> noisy = add_noise(grid, faces, level=0.1, seed=3)
        >>> bool(np.all(noisy[:, :2] == grid[:, :2])), bool(np.any(noisy[:, 2] != 0))
        (True, True)
    """
    return NoiseSource(vertices, faces).sample(kind=kind, level=level, fraction=fraction, seed=seed)


class NoiseSource:
    """A clean mesh with what every noisy version of it needs, for drawing many: see `add_noise` for the formulas.

    Args:
        vertices: (V, 3) float64, clean positions in mesh units.
        faces: (F, 3), vertex ids.

    Raises:
        MeshError: A face has an id that is no vertex.
    """

    def __init__(self, vertices: FloatArray, faces: FaceArray) -> None:
        refuse_fork()
        self._clean = np.asarray(vertices, dtype=np.float64)
        # Adding zero turns -0.0 into 0.0, so that both are one position.
        welded, inverse = np.unique(self._clean + 0.0, axis=0, return_inverse=True)
        self._inverse = inverse.reshape(-1)
        ids = np.asarray(faces)
        outside = (ids < 0) | (ids >= len(self._clean))
        if outside.any():
            face_id = int(np.argwhere(outside)[0, 0])
            raise MeshError(
                f"face {face_id} is {ids[face_id].tolist()}, but there are {len(self._clean)} vertices"
            )
        self._faces = self._inverse[ids]
        self._normals = vertex_normals(start.near_1(welded, self._faces)[0], self._faces)
        self.mean_edge = mean_edge_length(welded, self._faces)

    def sample(
        self, *, kind: NoiseKind = "gaussian", level: float = 0.2, fraction: float = 0.3, seed: int = 0
    ) -> FloatArray:
        """Return one noisy version, (V, 3) float64; arguments and errors as in `add_noise`."""
        _check(kind, level, fraction, seed)
        rng = np.random.default_rng(seed)
        n_vertices = len(self._normals)
        if kind == "isotropic":
            offset = rng.standard_normal((n_vertices, 3))
        else:
            amplitude = _AMPLITUDES[kind](rng, n_vertices, self._faces, fraction)
            offset = amplitude[:, None] * self._normals
        return np.asarray(self._clean + level * self.mean_edge * offset[self._inverse], dtype=np.float64)


def _check(kind: str, level: float, fraction: float, seed: int) -> None:
    if kind not in NOISE_KINDS:
        raise ConfigError(f"unknown noise kind {kind!r}", hint=f"use one of {', '.join(NOISE_KINDS)}")
    if not 0 <= level <= _MAX_LEVEL:
        raise ConfigError(f"noise level is {level}", hint=f"use 0 to {_MAX_LEVEL:.0f}, in mean edge lengths")
    if not 0 <= fraction <= 1:
        raise ConfigError(f"noise fraction is {fraction}", hint="use a number from 0 to 1")
    if seed < 0:
        raise ConfigError(f"noise seed is {seed}", hint="use a number >= 0")


def _unique_edges(faces: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """Return (E, 2) vertex id pairs, smaller id first, each once, without edges from a vertex to itself."""
    pairs: npt.NDArray[np.int64] = np.sort(
        faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1
    )
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    if len(pairs) == 0:
        return pairs
    n_vertices = int(pairs.max()) + 1
    keys: npt.NDArray[np.int64] = np.unique(pairs[:, 0] * n_vertices + pairs[:, 1])
    edges: npt.NDArray[np.int64] = np.stack([keys // n_vertices, keys % n_vertices], axis=1)
    return edges


def _averaging(n_vertices: int, faces: npt.NDArray[np.integer]) -> sparse.csr_array:
    """Return the (V, V) matrix that replaces each vertex value by the mean of it and its neighbours."""
    edges = _unique_edges(faces)
    own = np.arange(n_vertices)
    rows = np.concatenate([edges[:, 0], edges[:, 1], own])
    columns = np.concatenate([edges[:, 1], edges[:, 0], own])
    weights = 1.0 / np.bincount(rows, minlength=n_vertices)[rows]
    return sparse.csr_array((weights, (rows, columns)), shape=(n_vertices, n_vertices))


def smoothed(values: FloatArray, faces: npt.NDArray[np.integer], rounds: int) -> FloatArray:
    """Return vertex values averaged over the vertex graph `rounds` times.

    x_v <- (x_v + sum over the neighbours u of x_u) / (1 + number of neighbours).

    Args:
        values: (V,) float64.
        faces: (F, 3), vertex ids.
        rounds: How often, >= 0.

    Returns:
        (V,) float64.

    Example:
        >>> import numpy as np
        >>> smoothed(np.array([3.0, 0.0, 0.0]), np.array([[0, 1, 2]]), 1).tolist()
        [1.0, 1.0, 1.0]
    """
    average = _averaging(len(values), faces)
    for _ in range(rounds):
        values = average @ values
    return values


def _gaussian(
    rng: np.random.Generator, n_vertices: int, _faces: npt.NDArray[np.integer], _fraction: float
) -> FloatArray:
    return rng.standard_normal(n_vertices)


def _impulsive(
    rng: np.random.Generator, n_vertices: int, _faces: npt.NDArray[np.integer], fraction: float
) -> FloatArray:
    amplitude = np.zeros(n_vertices)
    moved = rng.choice(n_vertices, size=round(fraction * n_vertices), replace=False)
    amplitude[moved] = rng.standard_normal(len(moved))
    return amplitude


def _varying(
    rng: np.random.Generator, n_vertices: int, faces: npt.NDArray[np.integer], _fraction: float
) -> FloatArray:
    field = smoothed(rng.standard_normal(n_vertices), faces, _VARYING_SMOOTHING)
    # Ranks spread the factors evenly over their range whatever the field's distribution.
    share = np.argsort(np.argsort(field, kind="stable"), kind="stable") / max(n_vertices - 1, 1)
    low, high = VARYING_RANGE
    return rng.standard_normal(n_vertices) * (low + (high - low) * share)


def _correlated(
    rng: np.random.Generator, n_vertices: int, faces: npt.NDArray[np.integer], _fraction: float
) -> FloatArray:
    rounds = int(rng.integers(*_CORRELATED_SMOOTHING, endpoint=True))
    smooth = smoothed(rng.standard_normal(n_vertices), faces, rounds)
    scale = float(np.sqrt(np.mean(smooth**2)))
    return smooth / scale if scale > 0 else smooth


_AMPLITUDES: dict[
    NoiseKind, Callable[[np.random.Generator, int, npt.NDArray[np.integer], float], FloatArray]
] = {
    "gaussian": _gaussian,
    "impulsive": _impulsive,
    "varying": _varying,
    "correlated": _correlated,
}
