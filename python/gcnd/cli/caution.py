"""How the program tells warnings: in a line of its own, without a place in the code."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from gcnd.errors import MeshWarning

__all__ = ["ignoring_warnings", "telling_warnings"]


@contextmanager
def telling_warnings() -> Iterator[None]:
    """Prints every `MeshWarning` of the block as `warning: …` on stderr; others go where they went."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", MeshWarning)
        others = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, MeshWarning):
                print(f"warning: {message}", file=sys.stderr)
            else:
                others(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield


@contextmanager
def ignoring_warnings() -> Iterator[None]:
    """Leaves out every `MeshWarning` of the block, for who tells them otherwise."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        yield
