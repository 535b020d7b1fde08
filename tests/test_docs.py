"""The documents hold together: choices named in code exist, modules say what they are, links lead somewhere."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
CODE_FOLDERS = ("crates", "python")
DOCUMENT_FOLDERS = (*CODE_FOLDERS, "benches", "docs", "scripts", "tests")

CHOICE = re.compile(r"choices\.md#([\w-]+)")
HEADING = re.compile(r"#{1,6}\s+(.+?)\s*#*$")
FENCE = re.compile(r"\s*(```|~~~)")
INLINE_CODE = re.compile(r"(`+).+?\1")
INLINE_LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+[\"'][^)]*)?\)")
LINK_DEFINITION = re.compile(r"\s{0,3}\[[^\]]+\]:\s+<?([^\s>]+)>?")
EXTERNAL = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)


def files_below(root: Path, folders: tuple[str, ...], *suffixes: str) -> Iterator[Path]:
    """Files with one of the suffixes in the given folders of the root, hidden folders left out."""
    for folder in folders:
        for path in sorted((root / folder).rglob("*")):
            is_hidden = any(part.startswith(".") for part in path.relative_to(root).parts)
            if path.suffix in suffixes and path.is_file() and not is_hidden:
                yield path


def prose_lines(path: Path) -> Iterator[str]:
    """Lines of a Markdown file outside fenced blocks."""
    fence = None
    for line in path.read_text(encoding="utf-8").splitlines():
        mark = FENCE.match(line)
        if mark and fence in (None, mark[1]):
            fence = mark[1] if fence is None else None
        elif fence is None:
            yield line


def anchors(path: Path) -> set[str]:
    """The anchors that GitHub gives the headings of a Markdown file."""
    found: set[str] = set()
    for line in prose_lines(path):
        heading = HEADING.match(line)
        if heading:
            text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading[1]).lower()
            slug = plain = re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
            number = 0
            while slug in found:
                number += 1
                slug = f"{plain}-{number}"
            found.add(slug)
    return found


def unknown_choices(root: Path) -> list[str]:
    """Links from code to headings that docs/choices.md does not have, as 'file:line anchor'."""
    known = anchors(root / "docs" / "choices.md")
    return [
        f"{path.relative_to(root).as_posix()}:{number} {anchor}"
        for path in files_below(root, CODE_FOLDERS, ".rs", ".py", ".pyi")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        for anchor in CHOICE.findall(line)
        if anchor not in known
    ]


def modules_without_docstring(root: Path) -> list[str]:
    """Python modules of the package that do not say what they are."""
    return [
        path.relative_to(root).as_posix()
        for path in files_below(root, ("python/gcnd",), ".py", ".pyi")
        if not (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").strip()
    ]


def link_targets(path: Path) -> Iterator[str]:
    """Where the links and images of a Markdown file lead, links in code left out."""
    for line in prose_lines(path):
        text = INLINE_CODE.sub("", line)
        yield from INLINE_LINK.findall(text)
        definition = LINK_DEFINITION.match(text)
        if definition:
            yield definition[1]


def broken_links(root: Path) -> list[str]:
    """Relative links in Markdown files to files or headings that are not there, as 'file -> target'."""
    root = root.resolve()
    documents = [*sorted(root.glob("*.md")), *files_below(root, DOCUMENT_FOLDERS, ".md")]
    return [
        f"{document.relative_to(root).as_posix()} -> {target}"
        for document in documents
        for target in link_targets(document)
        if not EXTERNAL.match(target) and not leads_somewhere(root, document, target)
    ]


def leads_somewhere(root: Path, document: Path, target: str) -> bool:
    """Whether a link stays inside the repository and its file, and heading if it names one, exist."""
    name, _, anchor = target.partition("#")
    path = (document.parent / name).resolve() if name else document
    if not path.exists() or not path.is_relative_to(root):
        return False
    return not anchor or path.suffix != ".md" or anchor in anchors(path)


def test_choices_named_in_code_exist() -> None:
    assert unknown_choices(ROOT) == []


def test_every_module_says_what_it_is() -> None:
    assert modules_without_docstring(ROOT) == []


def test_relative_links_lead_somewhere() -> None:
    assert broken_links(ROOT) == []


def test_there_is_something_to_check() -> None:
    """Without this, moving a folder would turn every other test green."""
    code = "".join(
        p.read_text(encoding="utf-8") for p in files_below(ROOT, CODE_FOLDERS, ".rs", ".py", ".pyi")
    )
    assert len(CHOICE.findall(code)) >= 20
    assert len(list(files_below(ROOT, ("python/gcnd",), ".py", ".pyi"))) >= 40
    assert len(list(link_targets(ROOT / "docs" / "choices.md"))) >= 50


SOUND = {
    "docs/choices.md": (
        "# Choices\n\n### Frame signs\n\n### K = 8, *again*\n\n### Cover\n\n### Cover\n\n"
        "```\n### Not a heading\n[nor a link](nowhere.md)\n```\n\n"
        "[a](../README.md) [b](#cover-1) ![c](../python/gcnd/a.py#L3 'title') `[d](no)` <https://e.org>\n\n"
        "[f]: ../README.md#title\n"
    ),
    "README.md": "# Title\n\n[choices](docs/choices.md#frame-signs) [web](https://example.org/no.md)\n",
    "python/gcnd/a.py": '"""A module."""\n\nx = 1  # Choice: docs/choices.md#k--8-again.\n',
    "crates/a/src/lib.rs": "//! Choice: docs/choices.md#cover-1, docs/choices.md#frame-signs.\n",
    "python/.hidden/b.py": "# choices.md#hidden\n",
}


def write_tree(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")


def test_a_sound_tree_passes(tmp_path: Path) -> None:
    write_tree(tmp_path, SOUND)
    assert unknown_choices(tmp_path) == []
    assert modules_without_docstring(tmp_path) == []
    assert broken_links(tmp_path) == []


@pytest.mark.parametrize(
    ("check", "name", "text", "problem"),
    [
        (
            unknown_choices,
            "crates/a/src/b.rs",
            "//\n/// choices.md#not-a-heading",
            "crates/a/src/b.rs:2 not-a-heading",
        ),
        (unknown_choices, "python/gcnd/b.pyi", '"""choices.md#cover-2"""', "python/gcnd/b.pyi:1 cover-2"),
        (unknown_choices, "python/gcnd/c.py", "# choices.md#Cover", "python/gcnd/c.py:1 Cover"),
        (modules_without_docstring, "python/gcnd/nn/b.py", "x = 1\n'''late'''\n", "python/gcnd/nn/b.py"),
        (modules_without_docstring, "python/gcnd/b.py", '" "\n', "python/gcnd/b.py"),
        (modules_without_docstring, "python/gcnd/b.pyi", "", "python/gcnd/b.pyi"),
        (broken_links, "CHANGES.md", "[a](docs/no.md)", "CHANGES.md -> docs/no.md"),
        (broken_links, "docs/b.md", "see [a](../README.md#no), then", "docs/b.md -> ../README.md#no"),
        (broken_links, "docs/b.md", "# B\n[a](#c)", "docs/b.md -> #c"),
        (broken_links, "docs/b.md", "![a](picture.png)", "docs/b.md -> picture.png"),
        (broken_links, "docs/b.md", "[a]: no.md", "docs/b.md -> no.md"),
        (broken_links, "docs/b.md", "[a](../..)", "docs/b.md -> ../.."),
        (broken_links, "docs/b.md", "[a](/README.md)", "docs/b.md -> /README.md"),
    ],
)
def test_a_broken_tree_is_told(
    tmp_path: Path, check: Callable[[Path], list[str]], name: str, text: str, problem: str
) -> None:
    write_tree(tmp_path, SOUND | {name: text})
    assert check(tmp_path) == [problem]
