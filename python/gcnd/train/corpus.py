"""What a run learns from and is validated on: generated shapes, clean meshes, scans of them, or given pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gcnd.data.folders import find_meshes
from gcnd.data.generated import load_generated
from gcnd.data.pairs import PairFiles, list_pairs, load_pair
from gcnd.data.shapes_warp import bent, stretched
from gcnd.errors import ConfigError
from gcnd.mesh_io import load, to_arrays
from gcnd.scans import SCAN_KINDS
from gcnd.scans.training import TrainingPair, cropped, load_training_pairs
from gcnd.train.samples import (
    KIND_SHARES,
    CleanShape,
    FreshNoise,
    NoiseDraw,
    NoisyMesh,
    VertexSource,
    noisy_vertices,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from gcnd.train.recipes import Recipe

VALIDATION_SEED = 1_000_000
"""First seed of the procedural shapes that are validated on and never trained on."""

N_VALIDATION = 6
"""Meshes that a stage is validated on."""

VALIDATION_NOISE = NoiseDraw("gaussian", 0.2, 0.0, 12345)

MESH_WEIGHT = 4.0
"""A mesh that the user gave is drawn as often as this many generated ones of its kind, and so is each thinned form."""

GENERATED_HINT = "pip install 'gcnd[train]', or give --pairs"
"""What to do where shapes cannot be generated."""

SHAPES_AN_EDGED_PART = 3
"""For as many generated shapes there is one machine part with chamfers, fillets or steps."""

BLENDED_WEIGHT = 0.6
"""A generated machine part with its edges blended is drawn as often as this many of those with sharp edges."""

BLEND_WIDTHS = (0.5, 0.8, 1.2, 1.8)
"""How wide edges are blended, by turns, in mean edge lengths."""

FEWEST_FACES = 4000
"""A given mesh is thinned out to no fewer."""

N_WARPED = 4
"""Stretched and bent forms of every given mesh."""

WARPED_WEIGHT = 2.0
"""Each is drawn as often as this many generated ones of its kind."""

MOST_THINNED = 6.0
"""A stretched and bent form has a share of the faces between 1 / 6 and all of them."""


MADE_BETWEEN_LINES = 20
"""Shapes or scans made from one line of text to the next."""


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
    validation: list[NoisyMesh]


def generated_corpus(
    recipe: Recipe,
    shape_folder: Path,
    mesh_folder: Path | None,
    on_event: Callable[[str], None] | None = None,
) -> Corpus:
    """Makes or reads the procedural shapes of a recipe, adds the meshes of a folder, and draws noise for them.

    Folders named cad, smooth or feature, the nearest first, give the meshes of ``mesh_folder`` that kind; others
    are "feature". Meshes that are no machine parts are also learned from with fewer triangles, all of them also
    stretched and bent (see `given_shapes`), generated machine parts also with their edges blended; for every
    `SHAPES_AN_EDGED_PART` shapes there is a machine part with chamfers, fillets or steps besides.

    Args:
        recipe: Says how many shapes, and from which seed on.
        shape_folder: Keeps procedural shapes between runs.
        mesh_folder: Clean meshes of the user's, at any depth; read before any shape is made.
        on_event: Called with a line of text now and then while shapes are made.

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
    given = _shapes_of_folder(mesh_folder)
    tell = _counted("shapes", on_event)
    shapes = generated_shapes(recipe.n_shapes, recipe.seed, shape_folder, tell)
    n_edged = recipe.n_shapes // SHAPES_AN_EDGED_PART
    edged = edged_parts(n_edged, recipe.seed, shape_folder, _counted("parts with treated edges", on_event))
    shapes += blended_parts(shapes) + edged + given
    held_out = generated_shapes(N_VALIDATION, VALIDATION_SEED, shape_folder, tell)
    validation = [NoisyMesh.untouched(s, noisy_vertices(s, VALIDATION_NOISE)) for s in held_out]
    return Corpus(shapes, FreshNoise(shapes), validation)


def _counted(what: str, on_event: Callable[[str], None] | None) -> Callable[[int, int], None]:
    """Says now and then how much of something is made."""

    def tell(made: int, total: int) -> None:
        if on_event is not None and (made % MADE_BETWEEN_LINES == 0 or made == total):
            on_event(f"{what}: {made} of {total} made")

    return tell


def generated_shapes(
    n: int, seed: int, folder: Path, progress: Callable[[int, int], None] | None = None
) -> list[CleanShape]:
    """Loads ``n`` generated shapes from ``seed`` on, made and kept in ``folder`` where missing.

    ``progress`` is called with the shapes made and those to make after each.

    Raises:
        GcndError: What generates shapes is not installed.
    """
    shapes = load_generated(n, seed, folder, hint=GENERATED_HINT, progress=progress)
    return [CleanShape(s.name, s.kind, s.vertices, s.faces) for s in shapes]


def edged_parts(
    n: int, seed: int, folder: Path, progress: Callable[[int, int], None] | None = None
) -> list[CleanShape]:
    """Loads ``n`` machine parts with chamfered, filleted or stepped edges, from ``seed`` on, as `generated_shapes`.

    Raises:
        GcndError: What generates shapes is not installed.

    Choice: docs/choices.md#training-shapes.
    """
    shapes = load_generated(n, seed, folder, hint=GENERATED_HINT, kinds={"edged": 1.0}, progress=progress)
    return [CleanShape(s.name, "cad", s.vertices, s.faces) for s in shapes]


def blended_parts(shapes: list[CleanShape]) -> list[CleanShape]:
    """Makes of every machine part another with its edges blended over a few triangles.

    Where all edges are sharp, a network learns to make every narrow chamfer and fillet sharp. Planes stay planes.

    Choice: docs/choices.md#training-shapes.
    """
    from gcnd.data.shapes_blend import blended

    parts = [shape for shape in shapes if shape.kind == "cad"]
    found = []
    for number, part in enumerate(parts):
        vertices = blended(part.vertices, part.faces, BLEND_WIDTHS[number % len(BLEND_WIDTHS)])
        name = f"{part.name}, edges blended"
        found.append(CleanShape(name, part.kind, vertices, part.faces, draw_weight=BLENDED_WEIGHT))
    return found


def _shapes_of_folder(folder: Path | None) -> list[CleanShape]:
    if folder is None:
        return []
    return [shape for path in find_meshes(folder) for shape in given_shapes(path, _kind_of(path, folder))]


def _kind_of(path: Path, folder: Path) -> str:
    """The kind that the nearest folder of a mesh names, whatever its case; detailed where none does."""
    names = [part.lower() for part in (folder.resolve().name, *path.relative_to(folder).parts[:-1])]
    return next((name for name in reversed(names) if name in KIND_SHARES), "feature")


def given_shapes(path: Path, kind: str) -> list[CleanShape]:
    """Reads a clean mesh of the user's and makes more of it: thinned out by quadrics, stretched and bent.

    The same body with detail at the size of fewer triangles, as most published scans have it: with a half and a quarter
    of its faces as it is, and with a drawn share of them stretched and bent. Machine parts are stretched only, since
    their planes would be bent, and left with a few slivers; no mesh is left with too few faces. What is drawn depends
    on the file's name alone.

    Raises:
        MeshError: The mesh cannot be read.

    Choice: docs/choices.md#training-shapes.
    """
    arrays, _ = to_arrays(load(path))
    mesh, _ = arrays.welded()
    whole = CleanShape(path.stem, kind, mesh.vertices, mesh.faces, draw_weight=MESH_WEIGHT)
    shapes = [whole]
    for divisor in () if kind == "cad" else (2, 4):
        if len(mesh.faces) / divisor >= FEWEST_FACES:
            shapes.append(_thinned(whole, f"{path.stem}, 1/{divisor} of the faces", divisor))
    rng = np.random.default_rng(list(path.stem.encode()))
    return shapes + [_warped(whole, number, rng) for number in range(1, N_WARPED + 1)]


def _thinned(shape: CleanShape, name: str, divisor: float) -> CleanShape:
    from gcnd.data.shapes_decimate import decimated

    vertices, faces = decimated(shape.vertices, shape.faces, len(shape.faces) / divisor)
    return CleanShape(name, shape.kind, vertices, faces, shape.draw_weight)


def _warped(shape: CleanShape, number: int, rng: np.random.Generator) -> CleanShape:
    """A stretched form, of what is no machine part bent besides and thinned out by a drawn divisor."""
    name = f"{shape.name}, warped {number}"
    vertices, divisor = stretched(shape.vertices, rng), MOST_THINNED ** rng.uniform()
    if shape.kind == "cad":
        return CleanShape(name, shape.kind, vertices, shape.faces, WARPED_WEIGHT)
    form = CleanShape(name, shape.kind, bent(vertices, rng), shape.faces, WARPED_WEIGHT)
    return _thinned(form, name, divisor) if len(shape.faces) / divisor >= FEWEST_FACES else form


def scanned_corpus(
    recipe: Recipe,
    shape_folder: Path,
    mesh_folder: Path | None,
    scan_folder: Path,
    on_event: Callable[[str], None] | None = None,
) -> Corpus:
    """Scans the clean meshes that `generated_corpus` would add noise to, and validates on scans of held-out shapes.

    Every second scan is cut off somewhere, see `gcnd.scans.training.cropped`.

    Args:
        recipe: Says how many shapes and scans, and from which seed on.
        shape_folder: Keeps procedural shapes between runs.
        mesh_folder: Clean meshes of the user's, at any depth.
        scan_folder: Keeps the scans between runs.
        on_event: Called with a line of text now and then while scans are made.

    Raises:
        ConfigError: No mesh in ``mesh_folder``, or no scan to make.
        GcndError: What generates shapes or fuses frames is not installed.
        MeshError: A mesh cannot be read, or scans of it have too few faces.

    Choice: docs/choices.md#simulated-scans.

    Example:
        >>> from gcnd.train.recipes import get_recipe
        >>> corpus = scanned_corpus(
        ...     get_recipe("scan"), Path("shapes"), None, Path("scans")
        ... )  # doctest: +SKIP
    """
    if recipe.n_scans < 1:
        raise ConfigError(f"n_scans of recipe {recipe.name} is {recipe.n_scans}, allowed: 1 or more")
    given = _shapes_of_folder(mesh_folder)
    tell = _counted("shapes", on_event)
    meshes = generated_shapes(recipe.n_shapes, recipe.seed, shape_folder, tell) + given
    held_out = generated_shapes(N_VALIDATION, VALIDATION_SEED, shape_folder, tell)
    tell = _counted("scans", on_event)
    found = load_training_pairs(meshes, recipe.n_scans, recipe.seed, scan_folder, progress=tell)
    pairs = [
        _of_scan(cropped(pair, recipe.seed + number) if number % 2 else pair)
        for number, pair in enumerate(found)
    ]
    unseen = load_training_pairs(held_out, N_VALIDATION, VALIDATION_SEED, scan_folder, kinds=SCAN_KINDS)
    return Corpus([pair.shape for pair in pairs], PairSource(pairs), [_of_scan(pair) for pair in unseen])


def _of_scan(pair: TrainingPair) -> NoisyMesh:
    return _measured(pair.name, pair.noisy_vertices, pair.clean_vertices, pair.faces)


class PairSource:
    """Draws one of a dataset's noisy meshes; no noise is added."""

    def __init__(self, pairs: list[NoisyMesh]):
        self.pairs = pairs

    def draw(self, rng: np.random.Generator) -> NoisyMesh:
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
    return Corpus([pair.shape for pair in pairs], PairSource(pairs), [_read(pair) for pair in picked])


def _read(pair: PairFiles) -> NoisyMesh:
    return _measured(pair.noisy.stem, *load_pair(pair))


def _measured(
    name: str, noisy: NDArray[np.float64], clean: NDArray[np.float64], faces: NDArray[np.uint32]
) -> NoisyMesh:
    """A noisy mesh that was given with its truth, and to which no noise is added."""
    return NoisyMesh.untouched(CleanShape(name, "feature", clean, faces), noisy)
