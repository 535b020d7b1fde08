"""What an adapter of another library gives: functions that make a method ready, each with its named settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Vertices: TypeAlias = NDArray[np.float64]
Faces: TypeAlias = NDArray[np.uint32]
Setting: TypeAlias = bool | int | float

Denoiser: TypeAlias = Callable[[Vertices, Faces], tuple[Vertices, Faces]]
"""Takes noisy positions (V, 3) and faces (F, 3), returns positions and faces as the library gives them back."""


@dataclass(frozen=True)
class Adapted:
    """Describes one method of a library at one setting.

    Attributes:
        make: Imports the library and returns the method at the settings given as keywords; what it does is start-up
            and not timed.
        settings: Every parameter that is passed, by the library's own names.
    """

    make: Callable[..., Denoiser]
    settings: Mapping[str, Setting]


@dataclass(frozen=True)
class Library:
    """Describes a library that other methods come from.

    Attributes:
        name: What stands before the colon in ``name:method``; also the distribution that pip installs.
        module: What is imported.
        methods: By the name after the colon.
        hint: What else an import may lack, or None.
    """

    name: str
    module: str
    methods: Mapping[str, Adapted]
    hint: str | None = None
