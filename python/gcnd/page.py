"""Parts of self-contained HTML pages: style, pictures and charts inside the page, nothing fetched."""

from __future__ import annotations

import base64
import html
import re
import warnings
from io import StringIO
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["STYLE", "data_uri", "html_page", "inline_svg"]

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
table { border-collapse: collapse; display: block; overflow-x: auto; max-width: 100% }
td, th { padding: .2rem .8rem; text-align: right; border-bottom: 1px solid #ddd }
img, svg { max-width: 100%; height: auto } h2 { margin-top: 2.5rem }
"""

_METADATA = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_NAMESPACE = re.compile(r'\sxmlns(?::\w+)?="[^"]*"')


def html_page(title: str, body: str, style: str = "") -> str:
    """Return a whole page around a body.

    Args:
        title: Plain text.
        body: HTML.
        style: CSS on top of `STYLE`.

    Example:
        >>> html_page("a < b", "<p>text").startswith("<!doctype html><html lang=en><meta charset=utf-8>")
        True
    """
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        '<meta name=viewport content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{STYLE}{style}</style><body>{body}</body></html>\n"
    )


def data_uri(data: bytes, kind: str) -> str:
    """Return what an ``img`` takes as its source.

    Args:
        data: The picture.
        kind: "png" or "webp".

    Example:
        >>> data_uri(b"abc", "png")
        'data:image/png;base64,YWJj'
    """
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def inline_svg(figure: Figure) -> str:
    """Return a chart as SVG that stands in a page: no XML head, no metadata, no namespaces, which HTML knows itself.

    Letters are outlines, so that the chart looks the same everywhere; where the font lacks one, the browser draws all.
    """
    try:
        svg = _svg(figure, "path", "error")
    except UserWarning:
        svg = _svg(figure, "none", "ignore")
    svg = _METADATA.sub("", svg[svg.index("<svg") :])
    return _NAMESPACE.sub("", svg)


def _svg(figure: Figure, letters: Literal["path", "none"], if_missing: Literal["error", "ignore"]) -> str:
    from matplotlib import rc_context

    text = StringIO()
    with rc_context({"svg.fonttype": letters}), warnings.catch_warnings():
        warnings.filterwarnings(if_missing, r"Glyph \d+ .* missing from", UserWarning)
        figure.savefig(text, format="svg")
    return text.getvalue()
