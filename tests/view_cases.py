"""A square of two triangles, and what a page of `gcnd view` holds, for tests of it."""

from __future__ import annotations

import base64
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Two right triangles in the plane z = 0 that share their long edge; mean edge (4 + √2) / 5.
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
EDGE = (4 + np.sqrt(2)) / 5
# Corner 1 lifted: it turns face 0 alone.
LIFTED = SQUARE + np.outer([0, 1, 0, 0], [0, 0, 1])


class Page(HTMLParser):
    """What a browser would fetch or run, and the text of elements with an id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.texts: dict[str, str] = {}
        self.kinds: dict[str, str | None] = {}
        self.policy = ""
        self._open: list[str | None] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        own = dict(attributes)
        self.links += [
            value or "" for name, value in attributes if name in ("src", "href", "srcset", "action")
        ]
        if own.get("http-equiv") == "Content-Security-Policy":
            self.policy = own["content"] or ""
        if own.get("id"):
            self.kinds[str(own["id"])] = own.get("type")
        if tag == "script":
            self._open = [own.get("id")]

    def handle_data(self, data: str) -> None:
        if self._open and self._open[0]:
            self.texts[self._open[0]] = self.texts.get(self._open[0], "") + data

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._open = []

    def array(self, name: str, kind: str) -> NDArray[Any]:
        return np.frombuffer(base64.b64decode(self.texts[name]), kind)


def page_of(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))
