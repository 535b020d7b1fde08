"""What a run's folder was begun with: another command than the first does not go on there."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd.errors import ConfigError
from gcnd.formats.atomic import write_atomic

if TYPE_CHECKING:
    from pathlib import Path

    from torch import nn

    from gcnd.nn.cascade import Cascade
    from gcnd.train.corpus import Corpus
    from gcnd.train.recipes import Recipe
    from gcnd.train.samples import CleanShape

_FILE = "run.json"


def shape_fingerprint(shape: CleanShape) -> str:
    """Tells a clean mesh from any other: a hash of its vertices and faces.

    Example:
        >>> from gcnd.train.samples import CleanShape
        >>> triangle = CleanShape("t", "cad", np.eye(3), np.array([[0, 1, 2]], np.uint32))
        >>> len(shape_fingerprint(triangle))
        64
    """
    arrays = (shape.vertices, shape.faces)
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def corpus_fingerprint(corpus: Corpus) -> str:
    """Tells what a run learns from: every shape, how often it is drawn, and positions that were given with it."""
    from gcnd.train.corpus import PairSource

    digest = hashlib.sha256()
    for shape in corpus.shapes:
        digest.update(f"{shape.kind} {shape.draw_weight} {shape_fingerprint(shape)}\n".encode())
    for pair in corpus.source.pairs if isinstance(corpus.source, PairSource) else []:
        digest.update(np.ascontiguousarray(pair.vertices).tobytes())
    return digest.hexdigest()


def weights_fingerprint(network: nn.Module) -> str:
    """Tells weights from others: a hash of every tensor and its name."""
    digest = hashlib.sha256()
    for name, tensor in network.state_dict().items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(tensor.detach().cpu().numpy()).tobytes())
    return digest.hexdigest()


def check_same_run(folder: Path, recipe: Recipe, corpus: Corpus, start: Cascade | None) -> None:
    """Writes down what the run of a folder is made of, or compares with what was written there.

    The settings of a stage are compared with its own files, see `gcnd.train.loop.check_settings`.

    Raises:
        ConfigError: The folder holds a run of another recipe, other meshes, or other weights to start from.
    """
    told: dict[str, Any] = {
        "recipe": [recipe.name, recipe.seed, recipe.pool_size],
        "meshes": corpus_fingerprint(corpus),
        "weights to start from": None if start is None else weights_fingerprint(start),
    }
    path = folder / _FILE
    if not path.exists():
        write_atomic(path, json.dumps(told, indent=1).encode())
        return
    try:
        former = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(
            f"{path} is damaged: {error}", hint="give another folder, or delete it if the command is the same"
        ) from error
    other = [
        name for name, value in told.items() if not isinstance(former, dict) or former.get(name) != value
    ]
    if other:
        raise ConfigError(
            f"{folder} holds a run with other {' and other '.join(other)}",
            hint="give the same command again, or another folder with --out",
        )
