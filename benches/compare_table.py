"""A table in Markdown of what `gcnd compare` wrote: mean E_a by kind of mesh or of scan, E_v, and time.

    gcnd compare builtin --methods all --levels 0.2 --pictures none --out runs/builtin
    gcnd compare DIR --methods all --levels 0.2 --pictures none --out runs/real
    python benches/compare_table.py generated=runs/builtin real=runs/real --times runs/times

    gcnd compare builtin --noise kinect1,kinect2,fusion,print --methods presets,classical --out runs/scans
    python benches/compare_table.py scans=runs/scans

A dataset with one noise has a column for each kind of mesh, one with several a column for each noise. Times are those
of another report, made on an idle machine, where one is given. Methods stand in the order of their mean E_a on the
last dataset.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from statistics import fmean
from typing import Any

Line = dict[str, Any]

SPOKEN = {"feature": "detailed"}


class Report:
    """The means of one dataset: ``columns`` by name, in each the lines of the methods."""

    def __init__(self, folder: Path):
        lines: list[Line] = json.loads((folder / "results.json").read_text(encoding="utf-8"))["summary"]
        whole = [line for line in lines if line["level"] == "all"]
        key = "noise" if len({line["noise"] for line in whole}) > 1 else "kind"
        self.columns: dict[str, dict[str, Line]] = {}
        for line in whole:
            if (line["kind"] == "all") == (key == "noise"):
                self.columns.setdefault(line[key], {})[line["method"]] = line
        self.methods = {line["method"]: line for line in whole if line["kind"] == "all"}

    def mean(self, method: str, value: str) -> float | None:
        """Mean of a value over the columns; None where one is missing."""
        values = [of[method][value] if method in of else None for of in self.columns.values()]
        return None if None in values else fmean(values)


def text(value: float | None, digits: int = 2) -> str:
    """A number, or a dash."""
    return "–" if value is None else f"{value:.{digits}f}"


def error_text(line: Line | None) -> str:
    """E_a, and how many meshes are missing in it."""
    if line is None:
        return "–"
    return text(line["e_a"]) + (f" ({line['failed']} failed)" if line["failed"] else "")


def table(reports: dict[str, Report], times: Report | None) -> list[str]:
    """The lines of the table."""
    last = [*reports.values()][-1]
    timed = (times or last).methods
    head = [f"{name} {SPOKEN.get(column, column)}" for name, of in reports.items() for column in of.columns]
    head += [f"{name}, mean {value}" for name in reports for value in ("E_a", "E_v")]
    lines = [f"| method | {' | '.join(head)} | s per million faces |", "|---" * (len(head) + 2) + "|"]
    for method in sorted(last.methods, key=lambda m: last.mean(m, "e_a") or 1e9):
        cells = [error_text(column.get(method)) for of in reports.values() for column in of.columns.values()]
        cells += [text(of.mean(method, value)) for of in reports.values() for value in ("e_a", "e_v")]
        of_time = timed.get(method)
        is_one = of_time is not None and not of_time["is_choice"]
        cells.append(text(of_time["seconds_per_million"] if of_time and is_one else None, 1))
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return lines


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("reports", nargs="+", metavar="NAME=FOLDER")
    parser.add_argument("--times", type=Path)
    options = parser.parse_args()
    pairs = [report.partition("=") for report in options.reports]
    reports = {name: Report(Path(folder)) for name, _, folder in pairs}
    print("\n".join(table(reports, None if options.times is None else Report(options.times))))


if __name__ == "__main__":
    main()
