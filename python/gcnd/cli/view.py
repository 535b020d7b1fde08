"""`gcnd view`: a page that shows a mesh before and after."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gcnd.cli.options import JsonFlag, print_json

__all__ = ["run"]


def run(
    clean_mesh: Annotated[Path, typer.Argument(metavar="CLEAN", help="The mesh after, such as a result.")],
    against: Annotated[
        Path, typer.Option(metavar="NOISY", help="The mesh before, with the same faces.", show_default=False)
    ],
    truth: Annotated[
        Path | None,
        typer.Option(metavar="TRUTH", help="The true mesh, with the same faces.", show_default=False),
    ] = None,
    out: Annotated[Path, typer.Option(help="The page to write; an existing one is replaced.")] = Path(
        "view.html"
    ),
    as_json: JsonFlag = False,
) -> None:
    """Write one HTML page that shows CLEAN against NOISY: a 3D view that opens without a network, and figures."""
    from gcnd.viewer.view import view

    figures = view(clean_mesh, against=against, truth=truth, out=out)
    if as_json:
        print_json(asdict(figures))
    print(f"wrote {out}: {figures.faces} faces, {out.stat().st_size / 1e6:.1f} MB", file=sys.stderr)
