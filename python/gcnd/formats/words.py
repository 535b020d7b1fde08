"""Numbers put in the place of others in a text, with all that stands around them left alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

__all__ = ["replaced_words", "text_lines"]


def text_lines(data: bytes) -> list[str]:
    """Splits a text file as its readers do; joined and encoded with "surrogateescape" it is the same bytes."""
    # Of bytes: in text, there are ends of lines that no format of meshes has.
    return [line.decode("utf-8", errors="surrogateescape") for line in data.splitlines(keepends=True)]


_WORD = re.compile(r"(?:(?!\\\r?\n)\S)+")
"""What stands between spaces; a backslash at the end of a line, which joins it to the next, is none."""


def replaced_words(line: str, first: int, numbers: Iterable[float]) -> str:
    """Replaces words of a line by numbers, with the digits that read back exactly.

    Args:
        line: The line, with its end.
        first: Which word the first number replaces, from 0.
        numbers: The numbers.

    Returns:
        The line with the same spaces.

    Example:
        >>> replaced_words(" v 0  1 2 # edge\\n", 1, [0.5, 1.5, 2.5])
        ' v 0.5  1.5 2.5 # edge\\n'
    """
    values: Sequence[float] = list(numbers)
    spans = [match.span() for match in _WORD.finditer(line)][first : first + len(values)]
    pieces, end = [], 0
    for (start, stop), value in zip(spans, values, strict=True):
        pieces += [line[end:start], repr(float(value))]
        end = stop
    return "".join([*pieces, line[end:]])
