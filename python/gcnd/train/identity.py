"""What a run's folder was begun with: another command than the first does not go on there."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from gcnd.errors import ConfigError
from gcnd.formats.atomic import write_atomic
from gcnd.weights.registry import weights_hash

if TYPE_CHECKING:
    from pathlib import Path

    from gcnd.train.corpus import Corpus
    from gcnd.train.recipes import Recipe

_FILE = "run.json"


def corpus_fingerprint(corpus: Corpus) -> str:
    """Tells what a run learns from: every shape, how often it is drawn, and positions that were given with it."""
    from gcnd.train.corpus import PairSource

    digest = hashlib.sha256()
    for shape in corpus.shapes:
        digest.update(f"{shape.kind} {shape.draw_weight} {shape.fingerprint}\n".encode())
    for pair in corpus.source.pairs if isinstance(corpus.source, PairSource) else []:
        digest.update(np.ascontiguousarray(pair.vertices).tobytes())
    return digest.hexdigest()


def check_same_run(folder: Path, recipe: Recipe, corpus: Corpus, start_from: str | None) -> None:
    """Writes down what the run of a folder is made of, or compares with what was written there.

    The settings of a stage are compared with its own files, see `gcnd.train.loop.check_settings`.

    Raises:
        ConfigError: The folder holds a run of another recipe, other meshes, or other weights to start from.
    """
    told: dict[str, Any] = {
        "recipe": [recipe.name, recipe.seed, recipe.pool_size],
        "meshes": corpus_fingerprint(corpus),
        "weights to start from": None if start_from is None else weights_hash(start_from),
    }
    path = folder / _FILE
    if not path.exists():
        write_atomic(path, json.dumps(told, indent=1))
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
