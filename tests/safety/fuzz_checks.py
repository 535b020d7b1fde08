"""What a fuzzed entry may answer: a refusal that says why, or finite numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from wild import Rng

from gcnd.errors import GcndError

Case = Callable[[Rng, Path], bool]

CORE_REFUSALS = (GcndError, TypeError, OverflowError)
"""The binding is not public: Python's own errors for arguments of another type, or below zero, are clear enough."""


class Refused(Exception):
    """An input that was refused as it should be."""


@contextmanager
def refusals(*allowed: type[Exception]) -> Iterator[None]:
    """Turns allowed errors into `Refused`; checks that they say something, and not that memory ran out."""
    try:
        yield
    except allowed as error:
        message = str(error).strip()
        if not message or "MemoryError" in message or "Unable to allocate" in message:
            raise AssertionError(f"{type(error).__name__} is no refusal: {message!r}") from error
        raise Refused from error


def finite(values: Any) -> None:
    assert np.isfinite(np.asarray(values, dtype=np.float64)).all(), "NaN or infinity came out"


def unit_or_zero(normals: Any) -> None:
    lengths = np.linalg.norm(normals, axis=1)
    assert ((np.abs(lengths - 1.0) < 1e-9) | (lengths == 0.0)).all(), f"normals of lengths {lengths}"
