"""`gcnd denoise` on a folder: one bar for all, and a table of what became of each file."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gcnd.cli.caution import ignoring_warnings
from gcnd.cli.interrupt import Ended, nothing_to_lose, tidying_up
from gcnd.cli.options import print_json
from gcnd.cli.progress import show_progress
from gcnd.errors import GcndError, MeshError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
        from gcnd.many import denoise_many, is_done

        results = _results(input_folder, output_folder)
        if request.report is not None:
            output_folder.mkdir(parents=True, exist_ok=True)
            _check_report_path(request.report, results)
        method = request.method()
    known: dict[str, Outcome] = {}
    with tidying_up():
        try:
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
                    tell=lambda outcome: known.update({outcome.name: outcome}),
                )
        except (KeyboardInterrupt, Ended):
            if request.report is not None:
                _write_report(request.report, known, results, output_folder)
            if not quiet:
                made = [outcome.status == "done" for outcome in known.values()]
                there = made if overwrite else [is_done(*paths) for paths in results.items()]
                _tell_how_to_go_on(sum(there), len(results), overwrite)
            raise
        if request.report is not None:
            _write_report(request.report, known, results, output_folder)
    if as_json:
        print_json({"settings": request.settings, "files": [_row(outcome) for outcome in outcomes]})
    else:
        _print_summary(outcomes, quiet)
    if any(outcome.status == "failed" for outcome in outcomes):
        raise typer.Exit(1)


def _results(input_folder: Path, output_folder: Path) -> dict[Path, Path]:
    """Where the result of each mesh of the folder goes."""
    from gcnd.data.folders import mesh_files

    if output_folder.exists() and not output_folder.is_dir():
        raise MeshError(
            f"{output_folder} is a file, and {input_folder} a folder", "name a folder for the results"
        )
    files = mesh_files(input_folder, output_folder)
    return {path: output_folder / path.relative_to(input_folder) for path in files}


def _print_summary(outcomes: Sequence[Outcome], quiet: bool) -> None:
    """Prints the table and how many there are of each status; when quiet only what failed or has warnings, if any."""
    shown = [o for o in outcomes if not quiet or o.status == "failed" or o.warnings]
    if not shown:
        return
    _print_table(shown)
    counts = {status: sum(o.status == status for o in outcomes) for status in ("done", "skipped", "failed")}
    if counts["skipped"]:
        print(SKIPPED_HINT, file=sys.stderr)
    print(", ".join(f"{count} {status}" for status, count in counts.items()), file=sys.stderr)


def _tell_how_to_go_on(n_there: int, n_files: int, overwrite: bool) -> None:
    then = "with --overwrite it begins with the first" if overwrite else "results that are there are skipped"
    with suppress(OSError):  # a terminal that was closed reads no more
        print(f"stopped: {n_there} of {n_files} results are there", file=sys.stderr)
        print(f"\nhint: run the same command again; {then}", file=sys.stderr)


def _check_report_path(path: Path, results: Mapping[Path, Path]) -> None:
    """Checks that the report replaces no file of the run: none of the meshes, results, materials and textures."""
    from gcnd.formats.referred import paths_of_referred
    from gcnd.mesh_io import check_output_path

    others = [*results, *results.values()]
    for source, result in results.items():
        try:
            others += paths_of_referred(source, result)
        except MeshError:
            continue  # what is wrong with it is told when its turn comes, and it has no result
    check_output_path(path, *others, is_mesh=False)


def _write_report(
    path: Path, known: Mapping[str, Outcome], results: Mapping[Path, Path], output_folder: Path
) -> None:
    """Writes what became of each mesh; one that a stopped run did not come to the end of has the status "stopped"."""
    from gcnd.report import write_report

    former = _former_reports(path)
    rows = []
    for result in results.values():
        name = result.relative_to(output_folder).as_posix()
        outcome = known.get(name)
        is_there = outcome.status == "skipped" if outcome else result.is_file()
        row = _row(outcome) if outcome else _stopped_row(name, result if is_there else None)
        report = outcome.report if outcome else None
        rows.append(row | {"report": report or (former.get(name) if is_there else None)})
    write_report(path, rows)


def _former_reports(path: Path) -> dict[str, object]:
    """What an earlier run of the folder wrote there, by the names of the meshes; nothing where it is anything else."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else "[]"
    try:
        rows = json.loads(text)
    except ValueError:
        rows = []  # no report of ours: it is replaced
    known = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    return {str(row.get("name")): row.get("report") for row in known}


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


def _stopped_row(name: str, former_result: Path | None) -> dict[str, object]:
    from gcnd.many import Outcome

    return _row(Outcome(name, "skipped", output=former_result)) | {"status": "stopped"}


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
