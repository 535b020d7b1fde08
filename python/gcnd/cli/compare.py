"""`gcnd compare`: methods side by side on identical noisy meshes."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack, suppress
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gcnd.cli.interrupt import Ended, tidying_up
from gcnd.cli.options import JsonFlag, Seed, print_json
from gcnd.cli.progress import show_progress
from gcnd.errors import ConfigError, GcndError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gcnd.compare.rows import Row
    from gcnd.compare.summary import Line

__all__ = ["Pictures", "SplitName", "run"]

_WRITTEN = ("rows.jsonl", "results.csv", "results.json", "report.html")


class Pictures(str, Enum):
    """Which noisy meshes get pictures."""

    ONE = "one"
    ALL = "all"
    NONE = "none"


class SplitName(str, Enum):
    """Half of a dataset of pairs."""

    TEST = "test"
    TRAIN = "train"


def run(
    dataset: Annotated[
        str, typer.Argument(metavar="DATASET", help="Folder of pairs, folder of clean meshes, or builtin.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for tables, rows and the page.", show_default=False)],
    methods: Annotated[
        list[str] | None,
        typer.Option(help="Names, commas between; docs/compare.md.", show_default="presets,classical"),
    ] = None,
    noise: Annotated[
        str, typer.Option(help="Kinds of noise or scans for clean meshes, commas between.")
    ] = "gaussian",
    levels: Annotated[str, typer.Option(help="Of the noise, in mean edge lengths.")] = "0.1,0.2,0.3",
    fraction: Annotated[float, typer.Option(help="Of the vertices that impulsive noise moves.")] = 0.3,
    seed: Seed = 0,
    shapes: Annotated[int, typer.Option(min=1, help="Generated shapes of builtin.")] = 12,
    split: Annotated[SplitName, typer.Option(help="Half of a dataset of pairs.")] = SplitName.TEST,
    threads: Annotated[
        int | None, typer.Option(help="Processors for each method; all by default.", show_default=False)
    ] = None,
    timeout: Annotated[float, typer.Option(help="Seconds after which a method is ended.")] = 600.0,
    samples: Annotated[int, typer.Option(help="Points sampled on each surface for E_v.")] = 200_000,
    pictures: Annotated[
        Pictures, typer.Option(help="Pictures of one noisy mesh of each mesh, of all, or none.")
    ] = Pictures.ONE,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run failed rows again.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Run METHODS on the same noisy meshes and write tables, rows and a page; a stopped run goes on."""
    from gcnd.compare.cases import BUILTIN, NoisePlan, collect_cases, holds_pairs
    from gcnd.compare.finish import finish
    from gcnd.compare.methods import available, parse_methods
    from gcnd.compare.report import check_report_libraries
    from gcnd.compare.rows import INPUT, printable
    from gcnd.compare.run import Conditions, available_threads, check_output_folder, compare
    from gcnd.formats.lock import only_writer

    wanted = parse_methods(methods or ["presets,classical"])
    plan = NoisePlan(_words(noise), _numbers(levels), fraction, seed)
    processors = available_threads() if threads is None else threads
    conditions = Conditions(processors, timeout, samples, retry_failed)
    check_report_libraries()
    check_output_folder(out)
    _check_no_mesh_is_replaced(out, Path(dataset))
    usable, skipped = available(wanted)
    if not usable:
        raise ConfigError("no method is left to compare", hint="; ".join(skipped))
    options = {"dataset": printable(dataset), **asdict(conditions), **asdict(plan)}
    try:
        with tidying_up(), ExitStack() as held, show_progress(quiet=quiet) as progress:
            # A folder that is there or is written to at once is held from the start, another once all is read.
            if out.is_dir() or dataset == BUILTIN:
                held.enter_context(only_writer(out))
            cases = collect_cases(
                dataset, plan, n_shapes=shapes, shape_folder=out / "shapes", split=split.value
            )
            if not out.is_dir():
                held.enter_context(only_writer(out))
            if holds_pairs(Path(dataset)) and not quiet:
                print("--noise, --levels, --fraction and --seed are not for pairs", file=sys.stderr)
            for line in skipped:
                print(line, file=sys.stderr)
            rows = compare(cases, usable, out, conditions, progress=progress)
            lines = finish(
                out, options, cases, usable, rows, skipped=skipped, pictures=pictures.value, progress=progress
            )
    except (KeyboardInterrupt, Ended):
        with suppress(OSError):  # a terminal that was closed reads no more
            print(f"stopped: finished rows are in {out}, and the same command goes on", file=sys.stderr)
        raise
    if as_json:
        print_json([asdict(line) for line in lines])
    else:
        _print_means(lines)
    _print_failures(rows)
    if all(row.error is not None for row in rows if row.method != INPUT):
        raise GcndError("no method gave a result", hint="the reasons are above and in the report")
    if not quiet:
        print(f"wrote {out / 'report.html'}, results.csv and results.json", file=sys.stderr)


def _check_no_mesh_is_replaced(out: Path, dataset: Path) -> None:
    """Checks that what a comparison writes under one name leads to no mesh, as a link would."""
    from gcnd.data.folders import mesh_files
    from gcnd.mesh_io import check_output_path

    there = [path for path in (out / name for name in _WRITTEN) if os.path.lexists(path)]
    meshes = mesh_files(dataset) if there and dataset.is_dir() else []
    for path in there:
        check_output_path(path, *meshes, is_mesh=False)


def _words(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(dict.fromkeys(float(word) for word in _words(text)))
    except ValueError:
        raise ConfigError(f"levels is {text!r}, allowed: numbers with commas between") from None


def _print_means(lines: Sequence[Line]) -> None:
    """Prints a table for each noise: means over all meshes, and E_a at each level."""
    for noise in dict.fromkeys(line.noise for line in lines):
        own = [line for line in lines if line.noise == noise and line.kind == "all"]
        levels = [level for level in dict.fromkeys(line.level for line in own) if level != "all"]
        by_level = {(line.method, line.level): line.e_a for line in own}
        head = [
            "method",
            "runs",
            "E_a",
            *(f"at {level}" for level in levels),
            "E_v",
            "displaced",
            "flipped %",
        ]
        table = [[*head, "volume %", "s/Mfaces", "MiB"]]
        for line in own:
            if line.level == "all":
                runs = f"{line.runs - line.failed}/{line.runs}" if line.failed else str(line.runs)
                errors = [_number(by_level[line.method, level], 2) for level in levels]
                rest = [
                    _number(line.displacement_mean, 3),
                    _number(line.flipped, 3),
                    _number(line.volume_change, 3),
                    _number(line.seconds_per_million, 1),
                    _number(line.peak_mib, 0),
                ]
                table.append([line.method, runs, _number(line.e_a, 2), *errors, _number(line.e_v, 2), *rest])
        print(f"\nnoise: {noise}, means over all meshes")
        widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
        for row in table:
            cells = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
            print("  ".join([row[0].ljust(widths[0]), *cells]))


def _print_failures(rows: Sequence[Row]) -> None:
    """Says on stderr why methods failed, once for each reason, with the first mesh that it befell."""
    failed: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.error is not None:
            failed.setdefault((row.method, row.error), []).append(row)
    for (method, error), of in failed.items():
        more = f" and {len(of) - 1} more" if len(of) > 1 else ""
        print(f"failed: {method}, {of[0].mesh}, {of[0].noise} {of[0].level}{more}: {error}", file=sys.stderr)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
