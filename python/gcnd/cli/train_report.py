"""`gcnd train-report`: a page about a training run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["run"]


def run(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Folder that gcnd train wrote to.")],
    out: Annotated[
        Path | None, typer.Option(help="Page to write; by default report.html in the folder.")
    ] = None,
) -> None:
    """Write a page with loss and error curves and before/after pictures."""
    from gcnd.train.report import write_report

    page = out or run_folder / "report.html"
    write_report(run_folder, page)
    print(page)
