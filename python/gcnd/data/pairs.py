"""Noisy and clean meshes of the same faces on disk, in the folder layout of Wang et al. 2016."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gcnd import _geom
from gcnd.data.noise import FaceArray, FloatArray
from gcnd.errors import ConfigError, MeshError
from gcnd.mesh_io import SUPPORTED, load, to_arrays

Split = Literal["train", "test"]

_SUFFIX = re.compile(r"(.+)_[^_]+")

_SAME_FACES = "both need the same faces in the same order"


@dataclass(frozen=True)
class PairFiles:
    """Where a noisy mesh and its truth lie.

    Attributes:
        noisy: File below ``<split>/noisy``, named ``<model>_n1.obj``, ``<model>_noisy.obj`` or the like.
        clean: File ``<model>`` below ``<split>/original``.
    """

    noisy: Path
    clean: Path


def list_pairs(folder: Path | str, split: Split) -> list[PairFiles]:
    """Find the pairs of a dataset: every mesh of ``<split>/noisy`` with its truth in ``<split>/original``.

    The truth has the noisy file's name, or that name without what follows its last underscore; any supported
    extension will do.

    Args:
        folder: Holds ``train/noisy``, ``train/original``, ``test/noisy`` and ``test/original``.
        split: Which half.

    Returns:
        The pairs, ordered by the names of the noisy files.

    Raises:
        ConfigError: A folder is missing or holds no mesh, or a noisy mesh has no truth or two.

    Source: P.-S. Wang, Y. Liu, X. Tong, Mesh Denoising via Cascaded Normal Regression, 2016, for the layout.

    Example:
        >>> list_pairs("Kinect_v1", "train")[0].clean.name  # doctest: +SKIP
        'boy.obj'
    """
    noisy_folder, clean_folder = (Path(folder) / split / part for part in ("noisy", "original"))
    truths = _by_stem(_meshes(clean_folder))
    pairs = []
    for noisy in _meshes(noisy_folder):
        cut = _SUFFIX.fullmatch(noisy.stem)
        clean = truths.get(noisy.stem) or (truths.get(cut[1]) if cut else None)
        if clean is None:
            model = cut[1] if cut else noisy.stem
            raise ConfigError(
                f"{noisy} has no truth", hint=f"expected {clean_folder / model}.obj or the like"
            )
        pairs.append(PairFiles(noisy, clean))
    return pairs


def _by_stem(paths: list[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in paths:
        if path.stem in found:
            raise ConfigError(
                f"{found[path.stem]} and {path} are truths of one name", hint="rename or remove one of them"
            )
        found[path.stem] = path
    return found


def load_pair(pair: PairFiles) -> tuple[FloatArray, FloatArray, FaceArray]:
    """Read a pair.

    Args:
        pair: Where it lies.

    Returns:
        Noisy positions (V, 3) and clean positions (V, 3), float64 in mesh units, and their faces (F, 3), uint32.
        Vertices at one noisy position are welded, as an STL file needs it.

    Raises:
        MeshError: A file cannot be read, or the two differ in faces or vertices.

    Example:
        >>> noisy, clean, faces = load_pair(list_pairs("Kinect_v1", "train")[0])  # doctest: +SKIP
    """
    noisy, clean = (to_arrays(load(path))[0] for path in (pair.noisy, pair.clean))
    for what, a, b in (
        ("vertices", len(noisy.vertices), len(clean.vertices)),
        ("faces", len(noisy.faces), len(clean.faces)),
    ):
        if a != b:
            raise MeshError(f"{pair.noisy} has {a} {what}, its truth {pair.clean} has {b}", hint=_SAME_FACES)
    differs = np.any(noisy.faces != clean.faces, axis=1)
    if differs.any():
        face_id = int(np.argmax(differs))
        raise MeshError(
            f"{pair.noisy} and its truth {pair.clean} differ in face {face_id}: "
            f"{noisy.faces[face_id].tolist()} and {clean.faces[face_id].tolist()}",
            hint=_SAME_FACES,
        )
    representatives, welded = _geom.weld(noisy.vertices)
    return noisy.vertices[representatives], clean.vertices[representatives], welded[noisy.faces]


def _meshes(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise ConfigError(
            f"no such folder: {folder}",
            hint="a dataset has train/noisy, train/original, test/noisy and test/original",
        )
    shown = (path for path in folder.iterdir() if not path.name.startswith("."))
    found = sorted(path for path in shown if path.suffix.lower() in SUPPORTED)
    if not found:
        raise ConfigError(f"no mesh in {folder}", hint=f"supported: {', '.join(SUPPORTED)}")
    return found
