"""Training patches, drawn anew for ever: shape × noise × faces, a pure function of (seed, chunk)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

import numpy as np
import torch
from torch import Tensor

from gcnd import _geom
from gcnd.data.noise import NOISE_KINDS, NoiseKind, NoiseSource
from gcnd.nn.transformer import vector_starts
from gcnd.predict import PatchArrays, make_extractor

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from gcnd.nn.cascade import PatchConfig

_NOISE_SHARES = (0.6, 0.15, 0.1, 0.1, 0.05)
"""Of the kinds of noise in training, in the order of ``NOISE_KINDS``."""

_MIXED_SHARE = 0.15
"""Of the noisy meshes whose noise is of two kinds."""

_BLUR_OF_ALL, _BLUR_OF_EACH = 0.05, 0.03
"""Deviations of log₁₀ of what a network in training is told of a mesh's roughness: about what it differs by from
surface to surface at the same noise."""

KIND_SHARES = {"cad": 0.3, "smooth": 0.3, "feature": 0.4}
"""How often each kind of shape is drawn; detailed ones, the hardest, a little more often."""

FEATURE_CLASSES = (1, 2)
"""Edge and corner faces in ``_geom.classify_faces``: the paper's group of feature faces (Sec. 5.2)."""


class Batch(NamedTuple):
    """Patches with what the network should answer.

    Attributes:
        features: (P, N, C) float32.
        neighbors: (P, N, 3) int32.
        target: Noise-free normals (P, N, 3) float32, patch frame; zero where the clean face has none.
        weight: (P, N) float32: exp(−2‖c̄‖²), zero for repeats and faces without a clean normal.
    """

    features: Tensor
    neighbors: Tensor
    target: Tensor
    weight: Tensor


@dataclass(frozen=True)
class NoiseDraw:
    """Parameters of noise of one kind on a shape."""

    kind: NoiseKind
    level: float
    fraction: float
    seed: int


@dataclass
class CleanShape:
    """A clean mesh with what every noisy version of it shares.

    Attributes:
        name: For logs and model cards.
        kind: "cad", "smooth" or "feature".
        vertices: (V, 3) float64.
        faces: (F, 3) uint32.
        draw_weight: How often it is drawn among the shapes of its kind, relative to the others.
    """

    name: str
    kind: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.uint32]
    draw_weight: float = 1.0
    topology: _geom.Topology = field(init=False)
    normals: NDArray[np.float64] = field(init=False)
    feature_faces: NDArray[np.uint32] = field(init=False)
    flat_faces: NDArray[np.uint32] = field(init=False)
    noise: NoiseSource = field(init=False)

    def __post_init__(self) -> None:
        self.topology = _geom.Topology(self.faces, len(self.vertices))
        self.normals = _geom.face_geometry(self.vertices, self.faces)[0]
        self.noise = NoiseSource(self.vertices, self.faces)
        is_feature = np.isin(_geom.classify_faces(self.topology, self.vertices), FEATURE_CLASSES)
        self.feature_faces = np.flatnonzero(is_feature).astype(np.uint32)
        self.flat_faces = np.flatnonzero(~is_feature).astype(np.uint32)

    @cached_property
    def fingerprint(self) -> str:
        """Tells it from any other: a hash of its vertices and faces."""
        arrays = (self.vertices, self.faces)
        return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


def draw_noise(rng: np.random.Generator) -> tuple[NoiseDraw, ...]:
    """Draws kinds and levels of noise as the default training sees them, to be added up.

    Gaussian along the normals in six of ten, the rest impulsive, isotropic, varying and correlated; levels
    0.05…0.4 of the mean edge in three of four, up to 0.7 in one of ten, else nearly clean: 10⁻³…0.05, evenly in
    their logarithm, and now and then clean. In 15 of a hundred the level l is shared with a second kind, l cos θ
    and l sin θ with θ evenly between 0 and 90°.

    Choice: docs/choices.md#training-noise.
    """
    range_drawn = int(rng.choice(4, p=[0.03, 0.12, 0.75, 0.1]))
    low, high = [(0.0, 0.0), (1e-3, 0.05), (0.05, 0.4), (0.4, 0.7)][range_drawn]
    level = float(rng.uniform(low, high))
    if range_drawn == 1:
        level = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    kinds = rng.choice(len(NOISE_KINDS), 2, replace=False, p=_NOISE_SHARES)
    angle = rng.uniform(0, np.pi / 2)
    parts = (level * np.cos(angle), level * np.sin(angle)) if rng.random() < _MIXED_SHARE else (level,)
    return tuple(
        NoiseDraw(NOISE_KINDS[kind], float(part), float(rng.uniform(0.1, 0.6)), int(rng.integers(2**31)))
        for kind, part in zip(kinds, parts, strict=False)
    )


def pick_faces(
    shape: CleanShape, count: int, balance_ratio: float | None, rng: np.random.Generator
) -> NDArray[np.uint32]:
    """Picks the centres of training patches, ``balance_ratio`` feature faces to every other one.

    ``None`` picks evenly over all faces. A shape with too few feature faces gives what it has, at most five
    picks of each on average, and fills up with others.

    Paper: Sec. 5.2, data balancing, r = 1.5.
    """
    if balance_ratio is None or len(shape.feature_faces) == 0 or len(shape.flat_faces) == 0:
        return rng.integers(0, len(shape.faces), count).astype(np.uint32)
    n_feature = min(round(count * balance_ratio / (1 + balance_ratio)), 5 * len(shape.feature_faces))
    return np.concatenate(
        [rng.choice(shape.feature_faces, n_feature), rng.choice(shape.flat_faces, count - n_feature)]
    )


class NoisyMesh(NamedTuple):
    """A clean shape with positions that a network is to learn from.

    Attributes:
        shape: The clean mesh.
        vertices: (V, 3) float64, noisy, or denoised by earlier stages.
        roughness: Of the mesh with its noise, before any stage (4,); see ``_geom.mesh_roughness``.
        first: Positions (V, 3) float64 before any stage.
    """

    shape: CleanShape
    vertices: NDArray[np.float64]
    roughness: NDArray[np.float64]
    first: NDArray[np.float64]

    @classmethod
    def untouched(cls, shape: CleanShape, vertices: NDArray[np.float64]) -> NoisyMesh:
        """Makes one of positions that no stage has denoised yet."""
        return cls(shape, vertices, _geom.mesh_roughness(shape.topology, vertices), vertices)


class VertexSource(Protocol):
    """Gives noisy positions to train on."""

    def draw(self, rng: np.random.Generator) -> NoisyMesh:
        """Returns a clean shape with noisy positions of its vertices."""
        ...


NoiseDrawer: TypeAlias = "Callable[[np.random.Generator], tuple[NoiseDraw, ...]]"
"""Draws the noise of one mesh: kinds and levels to be added up."""


class FreshNoise:
    """Draws a shape, its kind first so that each kind is seen as often as `KIND_SHARES` says, and fresh noise."""

    def __init__(self, shapes: list[CleanShape], draw_noise: NoiseDrawer = draw_noise):
        self.shapes, self.draw_noise = shapes, draw_noise
        kinds = sorted({s.kind for s in shapes})
        self.shares = np.zeros(len(shapes))
        for kind in kinds:
            own = np.array([s.draw_weight if s.kind == kind else 0.0 for s in shapes])
            self.shares += KIND_SHARES[kind] * own / own.sum()
        self.shares /= self.shares.sum()

    def draw(self, rng: np.random.Generator) -> NoisyMesh:
        """Returns a shape and its vertices with noise."""
        shape = self.shapes[int(rng.choice(len(self.shapes), p=self.shares))]
        return NoisyMesh.untouched(shape, noisy_vertices(shape, *self.draw_noise(rng)))


def noisy_vertices(shape: CleanShape, *noise: NoiseDraw) -> NDArray[np.float64]:
    """Adds draws of noise, each made for the clean shape, to its vertices."""
    moved = np.array(shape.vertices, dtype=np.float64)
    for n in noise:
        noisy = shape.noise.sample(kind=n.kind, level=n.level, fraction=n.fraction, seed=n.seed)
        moved += noisy - shape.vertices
    return moved


@dataclass(frozen=True)
class ChunkConfig:
    """How a chunk of patches is drawn: ``n_meshes`` noisy meshes, ``n_patches`` patches in all, shuffled."""

    n_meshes: int = 8
    n_patches: int = 4096
    balance_ratio: float | None = 1.5


def make_chunk(source: VertexSource, patch: PatchConfig, config: ChunkConfig, seed: int, index: int) -> Batch:
    """Makes chunk ``index`` of the endless stream that ``seed`` starts: the same for ever, on any machine."""
    rng = np.random.default_rng([seed, index])
    per_mesh = config.n_patches // config.n_meshes
    parts = [_patches_of_one_mesh(source, patch, per_mesh, config, rng) for _ in range(config.n_meshes)]
    order = torch.from_numpy(rng.permutation(per_mesh * config.n_meshes))
    return Batch(*(torch.cat([part[i] for part in parts])[order] for i in range(4)))


def _patches_of_one_mesh(
    source: VertexSource, patch: PatchConfig, count: int, config: ChunkConfig, rng: np.random.Generator
) -> Batch:
    shape, vertices, roughness, first = source.draw(rng)
    if patch.roughness:
        roughness = blurred(roughness, rng)
    extractor = make_extractor(shape.topology, vertices, patch, int(rng.integers(2**31)), roughness, first)
    patches = PatchArrays(count, patch)
    # In order of id, neighbouring patches find each other's faces in the cache; chunks are shuffled later.
    patches.fill(extractor, np.sort(pick_faces(shape, count, config.balance_ratio, rng)))
    clean = shape.normals[patches.face_ids]
    target = np.einsum("pnr,prc->pnc", clean, patches.world_from_patch).astype(np.float32)
    squared = np.square(patches.features[..., :3]).sum(-1)
    weight = np.exp(-2 * squared) * patches.mask * (np.square(clean).sum(-1) > 0.5)
    batch = Batch(
        torch.from_numpy(patches.features),
        torch.from_numpy(patches.neighbors),
        torch.from_numpy(target),
        torch.from_numpy(weight.astype(np.float32)),
    )
    return flip_frames(batch, rng)


def blurred(roughness: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Varies a mesh's roughness (4,) a little, all of it by one factor and each number by another.

    Told exactly, it would give away which mesh of a pool a patch is from.
    """
    spread = rng.normal(0, _BLUR_OF_ALL) + rng.normal(0, _BLUR_OF_EACH, roughness.shape)
    varied: NDArray[np.float64] = roughness * 10**spread
    return varied


def flip_frames(batch: Batch, rng: np.random.Generator) -> Batch:
    """Turns half of the frames by 180 degrees around e₁, the ambiguity that tensor voting leaves.

    Choice: docs/choices.md#frame-signs.
    """
    turn = torch.from_numpy(np.where(rng.random(len(batch.features)) < 0.5, -1.0, 1.0).astype(np.float32))
    turn = turn[:, None, None]
    for start in vector_starts(batch.features.shape[-1]):
        batch.features[..., start + 1 : start + 3] *= turn
    batch.target[..., 1:] *= turn
    return batch
