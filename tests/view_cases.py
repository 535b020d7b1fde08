"""A square of two triangles, and what a page of `gcnd view` holds, for tests of it."""

from __future__ import annotations

import base64
import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import gcnd
from gcnd.errors import GcndError
from gcnd.mesh_io import to_arrays
from gcnd.viewer.changes import Figures, compare_meshes
from gcnd.viewer.page import Names, view_page
from property_cases import cases

# Two right triangles in the plane z = 0 that share their long edge; mean edge (4 + √2) / 5.
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
EDGE = (4 + np.sqrt(2)) / 5
# Corner 1 lifted: it turns face 0 alone.
LIFTED = SQUARE + np.outer([0, 1, 0, 0], [0, 0, 1])

some = cases(100)


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


class Shown(Page):
    """The page as a browser takes it apart: its elements in order, and the text of those that show names or figures."""

    def __init__(self, text: str) -> None:
        self.elements: list[str] = []
        self.said: dict[str, str] = {}
        self.cells: list[str] = []
        self._now = ""
        super().__init__(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        super().handle_starttag(tag, attributes)
        own = dict(attributes)
        self.elements.append(f"{tag} {sorted(own)}")
        self._now = str(own.get("id", tag))
        if tag == "td":
            self.cells.append("")

    def handle_data(self, data: str) -> None:
        super().handle_data(data)
        if self._now == "td" and self.cells:
            self.cells[-1] += data
        else:
            self.said[self._now] = self.said.get(self._now, "") + data

    def handle_endtag(self, tag: str) -> None:
        super().handle_endtag(tag)
        self._now = ""


def shown(page: bytes) -> Shown:
    return Shown(page.decode())


def manifest_of(page: Page) -> dict[str, Any]:
    """JSON as browsers know it, which have no NaN."""
    found: dict[str, Any] = json.loads(page.texts["manifest"], parse_constant=lambda name: pytest.fail(name))
    return found


def values_of(page: Page, layer: dict[str, Any], when: str) -> NDArray[Any]:
    name = f"{layer['name']}-{when}"
    steps = page.array(name if name in page.texts else f"{layer['name']}-before", "<u2")
    return np.where(steps == 65535, np.nan, steps / 65534 * layer["top"])


@cache
def elements(has_truth: bool, n_layers: int) -> list[str]:
    """The elements of a page about meshes and names without anything odd."""
    truth = to_arrays((SQUARE, FACES))[0] if has_truth else None
    sure = None if n_layers == 2 + has_truth else np.ones(2)
    return Shown(plain_page(Names("a", "b", "c"), truth, sure)).elements


def plain_page(names: Names, truth: Any, sure: Any = None) -> str:
    before, after = (to_arrays((vertices, FACES))[0] for vertices in (SQUARE, LIFTED))
    layers, figures = compare_meshes(before, after, truth, sure)
    return view_page(before, after, layers, figures, names)


def asked(after: Any, **options: Any) -> tuple[Figures | None, GcndError | None]:
    """What `gcnd.view` returns, or why it refuses."""
    try:
        return gcnd.view(after, **options), None
    except GcndError as refusal:
        return None, refusal


@contextmanager
def folder_of_a_page(former: bytes | None = None) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "view.html"
        if former is not None:
            out.write_bytes(former)
        yield out
