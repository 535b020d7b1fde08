"""`gcnd.view` under any names: all that they do to a page is to stand in it."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gcnd
from gcnd.mesh_io import save, to_arrays
from gcnd.viewer.page import Names
from view_cases import (
    FACES,
    LIFTED,
    SQUARE,
    Shown,
    asked,
    elements,
    folder_of_a_page,
    manifest_of,
    plain_page,
    shown,
    some,
)

ODD = [
    *(
        "</script>",
        "<script>",
        "<!--",
        "-->",
        "]]>",
        "<b>",
        '"',
        "'",
        "&",
        "&lt;",
        "&#60;",
        "$title",
        "${x}",
        "$",
    ),
    *(
        "\\u003c",
        "\\",
        "\n",
        "\r",
        "\t",
        "\u2028",
        "\u202e",
        "网格",
        "é",
        "e\u0301",
        "🦀",
        "\udcff",
        "\x01",
        " ",
    ),
    *("javascript:", "http://x.y", "--", "%00", "{{", "a"),
]
texts = (
    st.lists(st.one_of(st.sampled_from(ODD), st.text(max_size=3)), min_size=1, max_size=5)
    .map("".join)
    .filter(bool)
)


def said(name: str) -> str:
    return name.encode(errors="backslashreplace").decode()


def check_names(page: Shown, names: Names) -> None:
    assert page.elements == elements(has_truth=names.truth is not None, n_layers=3)
    assert page.links == ["data:,"]
    title = said(f"{names.after} against {names.before}")
    assert page.said["title"] == page.said["h1"] == title
    for when, name in (("before", names.before), ("after", names.after)):
        assert page.said[f"tag-{when}"] == (when if name == when else said(f"{when}: {name}"))
    assert page.said["caption"] == f"From before to after{said(f'Against {names.truth}')}"
    manifest = manifest_of(page)
    assert (manifest["before"], manifest["after"]) == (names.before, names.after)
    # Else a browser would take it for the beginning or the end of a script, or of a comment.
    assert "<" not in page.texts["manifest"]


@settings(some, max_examples=60)
@given(texts, texts, texts)
def test_any_names_are_told_and_nothing_else(before: str, after: str, truth: str) -> None:
    names = Names(before, after, truth)
    page = plain_page(names, to_arrays((SQUARE, FACES))[0])
    check_names(shown(page.encode(errors="backslashreplace")), names)


def is_name(text: str) -> bool:
    """Whether a file system of Linux has it, with a dot and an extension behind."""
    try:
        data = os.fsencode(text)
    except UnicodeEncodeError:
        return False
    return 0 < len(data) < 100 and not {*data} & {*b"\0/"}


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not take any name")
@settings(some, max_examples=30)
@given(*[texts.filter(is_name)] * 4)
def test_files_of_any_name(before: str, after: str, truth: str, page: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths: list[Path] = []
        for stem, vertices in ((before, SQUARE), (after, LIFTED), (truth, SQUARE)):
            paths.append(Path(folder) / str(len(paths)) / f"{stem}.ply")
            paths[-1].parent.mkdir()
            save((vertices, FACES), paths[-1])
        contents = [path.read_bytes() for path in paths]
        out = Path(folder) / f"{page}.html"
        gcnd.view(paths[1], against=paths[0], truth=paths[2], out=out)
        check_names(shown(out.read_bytes()), Names(*(path.name for path in paths)))
        assert [path.read_bytes() for path in paths] == contents
        assert {path.name for path in Path(folder).iterdir()} == {"0", "1", "2", out.name}


NOWHERE = st.one_of(
    st.text(max_size=8),
    st.sampled_from(
        ["", ".", "..", "a\0b", "\ud800", "x" * 300, "x/" * 5000, "no/such", "~", "-", "a.ply/b"]
    ),
)


@settings(some, max_examples=60)
@given(NOWHERE, st.sampled_from(["after", "against", "truth", "out"]), st.booleans())
def test_a_name_that_no_file_has_is_refused(name: str, which: str, is_bare: bool) -> None:
    with folder_of_a_page() as out:
        if "/" in name and which == "out":
            name = f"no/{name}"
        path = f"{out.parent}/{name}" + ("" if is_bare else ".html" if which == "out" else ".ply")
        question: dict[str, Any] = {"after": (LIFTED, FACES), "against": (SQUARE, FACES), "out": out}
        _, refusal = asked(**question | {which: path})
        there = [path.name for path in out.parent.iterdir()]
        if refusal is not None:
            assert str(refusal)
            assert there == []
        else:
            assert which == "out"
            assert Path(path).suffix in (".html", ".htm")
            assert there == [Path(path).name]
