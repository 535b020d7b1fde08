"""Further stages than a recipe's: each stays only where the validation meshes come out better for it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gcnd import _geom
from gcnd.errors import ConfigError
from gcnd.formats.atomic import write_atomic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from gcnd.train.loop import TrainConfig
    from gcnd.train.samples import NoisyMesh

LEAST_GAIN = 0.01
"""Share of the error that a further stage must take away."""


class Verdict(NamedTuple):
    """What a further stage did to the validation meshes.

    Attributes:
        before: Mean E_a without it, in degrees.
        after: With it.
    """

    before: float
    after: float

    @property
    def is_better(self) -> bool:
        """Whether the cascade keeps the stage."""
        return self.after <= self.before * (1 - LEAST_GAIN)


def with_further_stages(stages: Sequence[TrainConfig], most_stages: int) -> Iterator[TrainConfig]:
    """Yields the stages of a recipe and then more like the last, each with a seed of its own."""
    yield from stages
    for more in range(1, most_stages - len(stages) + 1):
        yield replace(stages[-1], seed=stages[-1].seed + more)


def mean_error(meshes: Sequence[NoisyMesh]) -> float:
    """Mean over meshes of E_a between a mesh as it stands and its clean shape, in degrees (paper Eq. 7)."""
    errors = []
    for shape, vertices, _, _ in meshes:
        normals = _geom.face_geometry(vertices, shape.faces)[0]
        errors.append(float(np.nanmean(_geom.normal_angles(normals, shape.normals))))
    return float(np.mean(errors))


def write_verdict(path: Path, verdict: Verdict) -> None:
    """Writes a verdict down for the other processes and for a run that goes on."""
    write_atomic(path, json.dumps(verdict._asdict()))


def read_verdict(path: Path) -> Verdict:
    """Reads what ``write_verdict`` wrote.

    Raises:
        ConfigError: The file holds something else.
    """
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        return Verdict(float(stored["before"]), float(stored["after"]))
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} is damaged: {error}", hint="delete it; it is made again") from error
