"""Lets `make docs` read this project's docstrings: their `Example:` is what Google's style calls `Examples:`."""

from __future__ import annotations

import re
from typing import Any

import griffe


class Examples(griffe.Extension):
    """Renames the section, so that its lines become code."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Is called with everything that has been read."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)
