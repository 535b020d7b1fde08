"""What `make docs` does to the pages of docs/ so that links work on the site as they do in the repository.

Called by MkDocs (see mkdocs.yml). Anchors are GitHub's, links to files outside docs/ lead to the repository's web
address, and `docs/choices.md#heading` in a docstring becomes a link.
"""

from __future__ import annotations

import logging
import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

log = logging.getLogger("mkdocs.hooks")

FENCE = re.compile(r"\s*(```|~~~)")
LINK = re.compile(r"(\]\(\s*<?|^\s{0,3}\[[^\]]+\]:\s+<?)([^)\s>]+)")
EXTERNAL = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)
DOCUMENT = re.compile(r"docs/([\w-]+)\.md(#[\w-]+)?")


def slugify(text: str, separator: str) -> str:
    """Returns the anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", separator)


def outward(markdown: str, page: str, root: Path, source: str) -> tuple[str, list[str]]:
    """Rewrites the links of a page that leave docs/.

    Args:
        markdown: Text of the page.
        page: Its path below docs/, such as ``guides/statue.md``.
        root: Of the repository.
        source: Web address of the repository's files.

    Returns:
        The text, and the links that lead nowhere.
    """
    folder = posixpath.dirname(posixpath.join("docs", page))
    missing: list[str] = []

    def rewritten(match: re.Match[str]) -> str:
        target = match[2]
        name, hash_mark, anchor = target.partition("#")
        path = posixpath.normpath(posixpath.join(folder, name))
        if not name or EXTERNAL.match(target) or path.startswith("docs/"):
            return match[0]
        if path.startswith("..") or not (root / path).exists():
            missing.append(target)
            return match[0]
        return f"{match[1]}{source}/{path}{hash_mark}{anchor}"

    lines, fence = [], None
    for line in markdown.split("\n"):
        mark = FENCE.match(line)
        if mark and fence in (None, mark[1]):
            fence = mark[1] if fence is None else None
        elif fence is None:
            line = LINK.sub(rewritten, line)
        lines.append(line)
    return "\n".join(lines), missing


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Gives headings the anchors that they have on GitHub."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = slugify
    return config


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Sends links that leave docs/ to the repository; one that leads nowhere fails a strict build."""
    root = Path(config.docs_dir).parent
    text, missing = outward(markdown, page.file.src_uri, root, config.extra["source"])
    for target in missing:
        log.warning("%s: no such file: %s", page.file.src_uri, target)
    return text


def on_page_content(html: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Makes links of the documents that docstrings name."""

    def linked(match: re.Match[str]) -> str:
        if files.get_file_from_path(f"{match[1]}.md") is None:
            log.warning("%s: no such document: %s", page.file.src_uri, match[0])
            return match[0]
        address = posixpath.relpath(f"{match[1]}.html", posixpath.dirname(page.url) or ".")
        return f'<a href="{address}{match[2] or ""}">{match[0]}</a>'

    return DOCUMENT.sub(linked, html) if page.file.src_uri.startswith("reference/") else html
