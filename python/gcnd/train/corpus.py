"""What a run learns from and what it is validated on: generated shapes, clean meshes, or pairs of noisy and clean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gcnd.data.folders import find_meshes
from gcnd.data.generated import load_generated
from gcnd.data.pairs import PairFiles, list_pairs, load_pair
from gcnd.mesh_io import load, to_arrays
from gcnd.train.samples import CleanShape, FreshNoise, NoiseDraw, VertexSource, noisy_vertices

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from gcnd.train.recipes import Recipe

VALIDATION_SEED = 1_000_000
"""First seed of the procedural shapes that are validated on and never trained on."""

N_VALIDATION = 6
"""Meshes that a stage is validated on."""

VALIDATION_NOISE = NoiseDraw("gaussian", 0.2, 0.0, 12345)

MESH_WEIGHT = 4.0
"""A mesh that the user gave is drawn as often as this many generated ones of its kind."""


@dataclass(frozen=True)
class Corpus:
    """Meshes of one run.

    Attributes:
        shapes: Every clean mesh that ``source`` draws.
        source: Gives noisy positions to train on.
        validation: Clean meshes with noisy positions (V, 3), none of them trained on.
    """

    shapes: list[CleanShape]
    source: VertexSource
    validation: list[tuple[CleanShape, NDArray[np.float64]]]


def generated_corpus(recipe: Recipe, shape_folder: Path, mesh_folder: Path | None) -> Corpus:
    """Makes or reads the procedural shapes of a recipe, adds the meshes of a folder, and draws noise for them.

    Subfolders of ``mesh_folder`` named cad, smooth or feature give their meshes that kind; others are "feature".

    Args:
        recipe: Says how many shapes, and from which seed on.
        shape_folder: Keeps procedural shapes between runs.
        mesh_folder: Clean meshes of the user's, at any depth.

    Raises:
        ConfigError: No mesh in ``mesh_folder``.
        GcndError: What generates shapes is not installed.
        MeshError: A mesh cannot be read.

    Choice: docs/choices.md#training-shapes.

    Example:
        >>> from gcnd.train.recipes import get_recipe
        >>> generated_corpus(get_recipe("default"), Path("shapes"), None).shapes[0].kind  # doctest: +SKIP
        'cad'
    """
    shapes = generated_shapes(recipe.n_shapes, recipe.seed, shape_folder)
    if mesh_folder is not None:
        shapes += [_given_shape(path) for path in find_meshes(mesh_folder)]
    held_out = generated_shapes(N_VALIDATION, VALIDATION_SEED, shape_folder)
    validation = [(shape, noisy_vertices(shape, VALIDATION_NOISE)) for shape in held_out]
    return Corpus(shapes, FreshNoise(shapes), validation)


def generated_shapes(n: int, seed: int, folder: Path) -> list[CleanShape]:
    """Loads ``n`` generated shapes from ``seed`` on, made and kept in ``folder`` where missing.

    Raises:
        GcndError: What generates shapes is not installed.
    """
    shapes = load_generated(n, seed, folder, hint="pip install 'gcnd[train]', or give --pairs")
    return [CleanShape(s.name, s.kind, s.vertices, s.faces) for s in shapes]


def _given_shape(path: Path) -> CleanShape:
    arrays, _ = to_arrays(load(path))
    kind = path.parent.name if path.parent.name in ("cad", "smooth", "feature") else "feature"
    mesh, _ = arrays.welded()
    return CleanShape(path.stem, kind, mesh.vertices, mesh.faces, draw_weight=MESH_WEIGHT)


class PairSource:
    """Draws one of a dataset's noisy meshes; no noise is added."""

    def __init__(self, pairs: list[tuple[CleanShape, NDArray[np.float64]]]):
        self.pairs = pairs

    def draw(self, rng: np.random.Generator) -> tuple[CleanShape, NDArray[np.float64]]:
        """Returns a clean shape and the noisy positions (V, 3) that were measured or made of it."""
        return self.pairs[int(rng.integers(len(self.pairs)))]


def paired_corpus(folder: Path) -> Corpus:
    """Reads a dataset of pairs: trains on its ``train`` half, validates on up to six meshes of its ``test`` half.

    Args:
        folder: Holds ``train`` and ``test``, as `gcnd.data.pairs.list_pairs` describes them.

    Raises:
        ConfigError: The layout is another.
        MeshError: A file cannot be read, or a pair's faces differ.

    Example:
        >>> len(paired_corpus(Path("Kinect_v1")).validation)  # doctest: +SKIP
        6
    """
    train, test = list_pairs(folder, "train"), list_pairs(folder, "test")
    picked = [test[i] for i in np.linspace(0, len(test) - 1, min(N_VALIDATION, len(test))).astype(int)]
    pairs = [_read(pair) for pair in train]
    return Corpus([shape for shape, _ in pairs], PairSource(pairs), [_read(pair) for pair in picked])


def _read(pair: PairFiles) -> tuple[CleanShape, NDArray[np.float64]]:
    noisy, clean, faces = load_pair(pair)
    return CleanShape(pair.noisy.stem, "feature", clean, faces), noisy
