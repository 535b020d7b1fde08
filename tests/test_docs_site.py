"""The site of `make docs`: what its hooks do to pages, every page in its navigation, every public name in it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import gcnd
from script_cases import ROOT, script

DOCS = ROOT / "docs"
DIRECTIVE = re.compile(r"^::: (\S+)$", re.MULTILINE)
SOURCE = "https://example.org/blob/main"

hooks = script("docs_hooks")


def settings() -> dict[str, Any]:
    yaml = pytest.importorskip("yaml")
    read: dict[str, Any] = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    return read


def nav_pages(nav: object) -> Iterator[str]:
    if isinstance(nav, str):
        yield nav
    elif isinstance(nav, dict):
        for below in nav.values():
            yield from nav_pages(below)
    elif isinstance(nav, list):
        for below in nav:
            yield from nav_pages(below)


def documented() -> list[str]:
    return [
        name
        for page in sorted((DOCS / "reference").glob("*.md"))
        for name in DIRECTIVE.findall(page.read_text(encoding="utf-8"))
    ]


def test_every_page_is_in_the_navigation_once() -> None:
    pages = list(nav_pages(settings()["nav"]))
    assert sorted(pages) == sorted(p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md"))


def test_nothing_is_fetched_and_broken_links_fail() -> None:
    read = settings()
    assert read["theme"]["font"] is False
    assert read["strict"] is True
    # With repo_url the theme asks the host for stars; scripts and styles of others would be fetched.
    assert not {"repo_url", "extra_javascript", "extra_css"} & set(read)
    assert set(read["validation"]["links"].values()) == {"warn"}


def test_source_links_lead_to_the_repository_of_the_crates() -> None:
    cargo = (ROOT / "Cargo.toml").read_text(encoding="utf-8")
    match = re.search(r'^repository = "(.+)"$', cargo, re.MULTILINE)
    assert match is not None
    assert settings()["extra"]["source"].startswith(f"{match[1]}/blob/")


@pytest.mark.parametrize("name", documented())
def test_documented_names_exist_and_have_a_docstring(name: str) -> None:
    module, _, last = name.rpartition(".")
    path = ROOT / "python" / Path(*module.split("."))
    file = path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"
    tree = ast.parse(file.read_text(encoding="utf-8"))
    found = [
        node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == last
    ]
    assert len(found) == 1
    assert ast.get_docstring(found[0])


def test_every_public_name_is_documented() -> None:
    names = documented()
    assert len(names) == len(set(names)) > 30
    last_parts = {name.rpartition(".")[2] for name in names}
    assert set(gcnd.__all__) - {"__version__"} <= last_parts


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[a](../README.md) b", f"[a]({SOURCE}/README.md) b"),
        ("![a](../README.md#title 'x')", f"![a]({SOURCE}/README.md#title 'x')"),
        ("[f]: ../README.md", f"[f]: {SOURCE}/README.md"),
        ("[a](choices.md#x) [b](#c) [d](https://example.org/../e)", None),
        ("```\n[a](../README.md)\n```", None),
    ],
)
def test_links_out_of_docs_lead_to_the_repository(text: str, expected: str | None) -> None:
    assert hooks.outward(text, "view.md", ROOT, SOURCE) == (expected or text, [])


def test_links_are_relative_to_the_page() -> None:
    text, missing = hooks.outward("[a](../../README.md) [b](../view.md)", "guides/statue.md", ROOT, SOURCE)
    assert (text, missing) == (f"[a]({SOURCE}/README.md) [b](../view.md)", [])


@pytest.mark.parametrize("target", ["../no.md", "../../outside.md"])
def test_links_that_lead_nowhere_are_told(target: str) -> None:
    assert hooks.outward(f"[a]({target})", "view.md", ROOT, SOURCE) == (f"[a]({target})", [target])


@pytest.mark.parametrize(
    ("heading", "anchor"),
    [("K = 8, again", "k--8-again"), ("Cover", "cover"), ("A CAD_part's", "a-cad_parts")],
)
def test_anchors_are_those_of_the_repository_host(heading: str, anchor: str) -> None:
    assert hooks.slugify(heading, "-") == anchor


def test_documents_named_in_docstrings_become_links() -> None:
    page = SimpleNamespace(url="reference/index.html", file=SimpleNamespace(src_uri="reference/index.md"))
    files = SimpleNamespace(get_file_from_path=lambda path: path if path == "choices.md" else None)
    text = "<p>Choice: docs/choices.md#cover. docs/no.md</p>"
    linked = hooks.on_page_content(text, page=page, config=None, files=files)
    assert linked == ('<p>Choice: <a href="../choices.html#cover">docs/choices.md#cover</a>. docs/no.md</p>')
    page.file.src_uri = "view.md"
    assert hooks.on_page_content(text, page=page, config=None, files=files) == text
