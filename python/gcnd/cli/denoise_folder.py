"""`gcnd denoise` on a folder: one bar for all, and a table of what became of each file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gcnd.cli.caution import ignoring_warnings
from gcnd.cli.interrupt import nothing_to_lose
from gcnd.cli.options import print_json
from gcnd.cli.progress import show_progress
from gcnd.errors import GcndError, MeshError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gcnd.cli.denoise import Request
    from gcnd.many import Outcome

__all__ = ["run_folder"]

SKIPPED_HINT = "skipped results were there already, whatever their settings; --overwrite makes them again"


def run_folder(
    input_folder: Path,
    output_folder: Path,
    request: Request,
    *,
    overwrite: bool,
    ray: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Denoises a folder, prints a table, and leaves with exit code 1 if a file failed.

    Args:
        input_folder: Searched with its subfolders.
        output_folder: Gets the results under the same names; made where missing.
        request: What the command line asked for.
        overwrite: Whether to work again on what is done.
        ray: Whether to work on a Ray cluster.
        quiet: Whether to print nothing but failures.
        as_json: Whether to print the table as JSON on stdout.
    """
    with nothing_to_lose():
        from gcnd.many import denoise_many, mesh_files
        from gcnd.mesh_io import check_output_path
        from gcnd.report import write_report

        if output_folder.exists() and not output_folder.is_dir():
            raise MeshError(
                f"{output_folder} is a file, and {input_folder} a folder", "name a folder for the results"
            )
        if request.report is not None:
            output_folder.mkdir(parents=True, exist_ok=True)
            files = mesh_files(input_folder, output_folder)
            results = [output_folder / path.relative_to(input_folder) for path in files]
            check_output_path(request.report, *files, *results, is_mesh=False)
        method = request.method()
    # The table tells them, with the names of the files.
    with ignoring_warnings(), show_progress(quiet=quiet) as progress:
        outcomes = denoise_many(
            input_folder,
            output_folder,
            denoiser=method,
            overwrite=overwrite,
            confidence=request.confidence,
            reports=request.report is not None,
            ray=ray,
            progress=progress,
        )
    if request.report is not None:
        former = _former_reports(request.report)
        rows = [_row(one) | {"report": one.report or _kept(one, former)} for one in outcomes]
        write_report(request.report, rows)
    failed = sum(outcome.status == "failed" for outcome in outcomes)
    if as_json:
        print_json({"settings": request.settings, "files": [_row(outcome) for outcome in outcomes]})
    elif failed or not quiet or any(outcome.warnings for outcome in outcomes):
        _print_table(outcomes if not quiet else [o for o in outcomes if o.status == "failed" or o.warnings])
        counts = [
            (status, sum(o.status == status for o in outcomes)) for status in ("done", "skipped", "failed")
        ]
        if dict(counts)["skipped"]:
            print(SKIPPED_HINT, file=sys.stderr)
        print(", ".join(f"{count} {status}" for status, count in counts), file=sys.stderr)
    if failed:
        raise typer.Exit(1)


def _former_reports(path: Path) -> dict[str, object]:
    """What an earlier run of the folder wrote there, by the names of the meshes; nothing where it is anything else."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else "[]"
    try:
        rows = json.loads(text)
    except ValueError:
        rows = []  # no report of ours: it is replaced
    known = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    return {str(row.get("name")): row.get("report") for row in known}


def _kept(outcome: Outcome, former: dict[str, object]) -> object:
    return former.get(outcome.name) if outcome.status == "skipped" else None


def _row(outcome: Outcome) -> dict[str, object]:
    return {
        "name": outcome.name,
        "status": outcome.status,
        "seconds": round(outcome.seconds, 3),
        "preset": outcome.preset,
        "output": None if outcome.output is None else str(outcome.output),
        "error": None if outcome.error is None else _told(outcome.error),
        "warnings": list(outcome.warnings),
    }


def _told(error: Exception) -> str:
    # gcnd's own errors say all; of any other the type is part of what went wrong.
    return str(error) if isinstance(error, GcndError) else f"{type(error).__name__}: {error}"


def _print_table(outcomes: Sequence[Outcome]) -> None:
    """Prints a line a file on stderr: status, seconds, name, and the preset or why it failed."""
    for outcome in outcomes:
        seconds = "" if outcome.status == "skipped" else f"{outcome.seconds:.1f} s"
        why = f"  {outcome.preset}" if outcome.preset else ""
        why = why if outcome.error is None else f": {_told(outcome.error)}"
        print(f"{outcome.status:<8}{seconds:>9}  {outcome.name}{why}", file=sys.stderr)
        for sentence in outcome.warnings:
            print(f"warning: {outcome.name}: {sentence}", file=sys.stderr)
